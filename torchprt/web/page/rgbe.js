// Radiance pictures (.hdr, .pic): flat, old and new run-length coding, as torchprt/light/rgbe.py. three.js has a loader
// of them that divides by 255 where Radiance has 256, and takes what is cut short for black.

const LARGEST = 2 ** 28;

/** `{data, width, height}` of the bytes: linear RGB, row after row from the top. Throws what is wrong in words. */
export function readRgbe(bytes) {
  const { scale, lines, length, rowsFirst, flips, start } = header(bytes);
  const quads = scanlines(bytes.subarray(start), lines, length);
  const [width, height] = rowsFirst ? [length, lines] : [lines, length];
  const data = new Float32Array(3 * width * height);
  for (let line = 0; line < lines; line++) {
    const along = flips[0] ? lines - 1 - line : line;
    for (let place = 0; place < length; place++) {
      const across = flips[1] ? length - 1 - place : place;
      const from = 4 * (line * length + place);
      const to = 3 * (rowsFirst ? along * width + across : across * width + along);
      const exponent = quads[from + 3];
      const unit = exponent ? 2 ** (exponent - 136) : 0;
      for (let c = 0; c < 3; c++) data[to + c] = (quads[from + c] * unit) / scale[c];
    }
  }
  return { data, width, height };
}

function header(bytes) {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, 65536));
  const end = text.indexOf("\n\n");
  const stop = text.indexOf("\n", end + 2);
  if (end < 0 || stop < 0) throw new Error("is truncated in its header");
  const scale = [1, 1, 1];
  for (const line of text.slice(0, end).split("\n")) {
    const [, key, value] = /^([A-Z]+)=(.*)$/.exec(line) ?? [];
    if (key === "FORMAT" && value.trim() !== "32-bit_rle_rgbe") throw new Error(`has pixels of format ${value.trim()}`);
    if (key !== "EXPOSURE" && key !== "COLORCORR") continue;
    const numbers = value.trim().split(/\s+/).map(Number);
    if (!numbers.every((each) => each > 0)) throw new Error(`has an unreadable ${key}`);
    for (let c = 0; c < 3; c++) scale[c] *= numbers[numbers.length === 3 ? c : 0];
  }
  const size = text.slice(end + 2, stop);
  const found = /^([+-])([XY]) (\d+) ([+-])([XY]) (\d+)\s*$/.exec(size);
  if (!found || found[2] === found[5]) throw new Error(`has an unreadable size (${size.slice(0, 40)})`);
  // Rows grow downward as Y decreases, columns rightward as X grows.
  const forward = { Y: "-", X: "+" };
  return {
    scale,
    lines: Number(found[3]),
    length: Number(found[6]),
    rowsFirst: found[2] === "Y",
    flips: [found[1] !== forward[found[2]], found[4] !== forward[found[5]]],
    start: stop + 1,
  };
}

function scanlines(data, lines, length) {
  if (lines * length > LARGEST) throw new Error(`claims ${lines} x ${length} pixels`);
  const quads = new Uint8Array(4 * lines * length);
  let at = 0;
  for (let line = 0; line < lines; line++) {
    if (data.length - at < 4 || data[at] !== 2 || data[at + 1] !== 2 || data[at + 2] > 127) {
      oldRuns(data.subarray(at), quads.subarray(4 * line * length));
      break;
    }
    if (((data[at + 2] << 8) | data[at + 3]) !== length) throw new Error(`is damaged in scan line ${line}`);
    at = newRuns(data, at + 4, length, quads.subarray(4 * line * length));
  }
  return quads;
}

/** One scan line: the four components one after the other, each in runs and literals. */
function newRuns(data, at, length, quads) {
  for (let component = 0; component < 4; component++) {
    for (let place = 0; place < length; ) {
      const lead = data[at++];
      const run = lead > 128;
      const count = run ? lead - 128 : lead;
      const taken = run ? 1 : count;
      if (!(count > 0) || place + count > length || at + taken > data.length) throw new Error("is truncated or damaged");
      for (let i = 0; i < count; i++, place++) quads[4 * place + component] = data[run ? at : at + i];
      at += taken;
    }
  }
  return at;
}

/** Pixels one after the other; mantissas 1, 1, 1 repeat the last pixel, consecutive ones in base 256. */
function oldRuns(data, quads) {
  let [at, to, digit] = [0, 0, 0];
  while (to < quads.length) {
    if (at + 4 > data.length) throw new Error("is truncated");
    const pixel = data.subarray(at, at + 4);
    at += 4;
    if (pixel[0] !== 1 || pixel[1] !== 1 || pixel[2] !== 1) {
      quads.set(pixel, to);
      to += 4;
      digit = 0;
      continue;
    }
    const count = pixel[3] * 256 ** digit++;
    if (to === 0 || digit > 4 || to + 4 * count > quads.length) throw new Error("is damaged (a run goes astray)");
    for (let i = 0; i < count; i++, to += 4) quads.copyWithin(to, to - 4, to);
  }
}
