// A file that was opened or dropped, as linear radiance, and in words what is wrong with it.
import { FloatType } from "three";
import { readRgbe } from "./rgbe.js";

// Red, green, blue and white of Rec. 709, which OpenEXR assumes when a file does not say otherwise.
const REC709 = { redX: 0.64, redY: 0.33, greenX: 0.3, greenY: 0.6, blueX: 0.15, blueY: 0.06, whiteX: 0.3127, whiteY: 0.329 };

/**
 * `{data, width, height, notes}` of a File, told by its content: OpenEXR, Radiance, or a picture that the browser
 * shows, as sRGB. `data`: 3 numbers a pixel from the top row on. `notes`: sentences on what was mended. Throws a sentence
 * on what is wrong.
 */
export async function readImage(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const starts = (...lead) => lead.every((byte, i) => bytes[i] === byte);
  let image;
  try {
    if (!bytes.length) throw new Error("is empty");
    if (starts(0x76, 0x2f, 0x31, 0x01)) image = await readExr(bytes);
    else if (starts(0x23, 0x3f)) image = readRgbe(bytes);
    else image = await readPicture(file, bytes, starts);
  } catch (fault) {
    throw new Error(`${file.name} ${fault.message}.`, { cause: fault });
  }
  const { width, height } = image;
  if (!width || width !== 2 * height) {
    throw new Error(
      `${file.name} is ${width} x ${height} pixels: an environment is a latitude-longitude map, twice as wide as high.`,
    );
  }
  return { ...image, notes: mend(image.data, file.name) };
}

async function readExr(bytes) {
  const { EXRLoader } = await import("./libraries/loaders/EXRLoader.js");
  let found;
  try {
    found = new EXRLoader().setDataType(FloatType).parse(bytes.buffer);
  } catch (fault) {
    throw new Error(`is damaged, or an OpenEXR that three.js does not read (${fault.message})`, { cause: fault });
  }
  const { header, width, height, data } = found;
  const stated = header.chromaticities;
  if (stated && Object.entries(REC709).some(([name, value]) => Math.abs(stated[name] - value) > 2e-3)) {
    throw new Error("states primaries other than Rec. 709: convert it");
  }
  if (["xMin", "yMin", "xMax", "yMax"].some((side) => header.dataWindow[side] !== header.displayWindow[side])) {
    throw new Error("is a crop of a larger picture: save it whole");
  }
  // The loader gives the bottom row first, and one number a pixel where there is luminance alone.
  const channels = data.length / (width * height);
  const pixels = new Float32Array(3 * width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const from = channels * ((height - 1 - row) * width + column);
      for (let c = 0; c < 3; c++) pixels[3 * (row * width + column) + c] = data[from + (channels < 3 ? 0 : c)];
    }
  }
  return { data: pixels, width, height };
}

async function readPicture(file, bytes, starts) {
  if (starts(0x89, 0x50, 0x4e, 0x47) && bytes[24] === 16 && [2, 6].includes(bytes[25])) {
    throw new Error("is a colour PNG of 16 bits, of which 8 would be lost: convert it to .exr");
  }
  let picture;
  try {
    picture = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (fault) {
    throw new Error("is damaged, or no image that this browser reads: give an .exr, .hdr, .jpg, .png or .webp", { cause: fault });
  }
  const { width, height } = picture;
  const canvas = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  canvas.drawImage(picture, 0, 0);
  const encoded = canvas.getImageData(0, 0, width, height).data;
  // IEC 61966-2-1.
  const linear = Float32Array.from({ length: 256 }, (_, i) => (i / 255 <= 0.04045 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4));
  const data = new Float32Array(3 * width * height);
  for (let i = 0; i < width * height; i++) {
    for (let c = 0; c < 3; c++) data[3 * i + c] = linear[encoded[4 * i + c]];
  }
  return { data, width, height };
}

/** Sets negative values to 0 and says so; refuses values that are not finite. */
function mend(data, name) {
  let [broken, negative, lowest] = [0, 0, 0];
  for (let i = 0; i < data.length; i++) {
    if (!Number.isFinite(data[i])) broken++;
    else if (data[i] < 0) {
      negative++;
      lowest = Math.min(lowest, data[i]);
      data[i] = 0;
    }
  }
  if (broken) {
    const values = broken === 1 ? "1 value that is" : `${broken} values that are`;
    throw new Error(`${name} holds ${values} not finite: mend it with torchprt light --repair.`);
  }
  if (!negative) return [];
  return [`${name}: ${negative === 1 ? "1 value was" : `${negative} values were`} negative, down to ${lowest.toPrecision(3)}, and set to 0.`];
}
