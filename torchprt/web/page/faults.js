// What can go wrong, each with what the one who looks at the page can do about it.

const BROWSER = "a current Firefox, Chrome, Edge or Safari";
const AGAIN = "Copy the whole folder to the server again; if that does not help, write the page again with torchprt export --web.";

/** A fault that `message.js` shows: `title` says what happened, the message the rest. */
export class Fault extends Error {
  constructor(title, text, cause) {
    super(text, { cause });
    this.title = title;
  }
}

/** What the server answered instead of a file. */
export function refused(url, { status, statusText }) {
  const answer = `${url} could not be loaded (${[status, statusText].filter(Boolean).join(" ")})`;
  if (status === 404 || status === 410) return new Fault("A file is missing on the server", `${answer}. ${AGAIN}`);
  if (status === 401 || status === 403) {
    return new Fault("The server does not give out a file", `${answer}. Look at the permissions of the file on the server.`);
  }
  if (status >= 500) return new Fault("The server has failed", `${answer}. Load the page again in a while.`);
  return new Fault("A file could not be loaded", `${answer}. ${AGAIN}`);
}

/** No answer at all. */
export const unreachable = (url, cause) =>
  new Fault(
    "The server does not answer",
    `${url} did not come. Look at the connection, and whether the server still runs; then load the page again.`,
    cause,
  );

export const damaged = (what, cause) => new Fault("A file of this page is damaged", `${what}. ${AGAIN}`, cause);

export const notOfOnePage = (what) => new Fault("Files of two pages are mixed", `${what}. ${AGAIN}`);

/** ONNX Runtime, or an allocation on the way to it, has thrown `cause` over a graph. */
export function notRun(url, bytes, cause) {
  const words = `${cause?.message ?? cause}`;
  if (cause instanceof RangeError || /alloc|out of memory|memory access/i.test(words)) {
    return new Fault(
      "There is not enough memory for this model",
      `${url} needs about ${Math.ceil((4 * bytes) / 2 ** 20)} MB in this browser (${words}). Close other tabs, or look ` +
        "at it on a machine with more memory; torchprt compress makes smaller models.",
      cause,
    );
  }
  return new Fault(
    "The model cannot be run",
    `ONNX Runtime cannot read ${url} (${words}). ${AGAIN}`,
    cause,
  );
}

/** Throws what this browser lacks. */
export function checkBrowser() {
  if (typeof WebAssembly !== "object") {
    throw new Fault(
      "This browser runs no WebAssembly",
      `The page computes its light in it. Use ${BROWSER}; lockdown and some private modes switch it off.`,
    );
  }
  // (func (v128.const 0) drop): SIMD.
  const vectors = [0, 97, 115, 109, 1, 0, 0, 0, 1, 4, 1, 96, 0, 0, 3, 2, 1, 0, 10, 23, 1, 21, 0, 253, 12];
  if (!WebAssembly.validate(Uint8Array.from([...vectors, ...Array(16).fill(0), 26, 11]))) {
    throw new Fault("This browser is too old for this page", `Its WebAssembly has no SIMD. Use ${BROWSER}.`);
  }
  if (typeof DecompressionStream !== "function") {
    throw new Fault("This browser is too old for this page", `It unpacks no gzip (DecompressionStream). Use ${BROWSER}.`);
  }
  if (!document.createElement("canvas").getContext("webgl2")) {
    throw new Fault(
      "This browser shows no WebGL 2",
      `The page draws with it. Use ${BROWSER}, and look whether graphics acceleration is switched off in its settings.`,
    );
  }
}

/** The content of a file beside the page, as `kind` ("json", "arrayBuffer", "blob"). */
export async function load(url, kind) {
  let response;
  try {
    response = await fetch(url);
  } catch (fault) {
    throw unreachable(url, fault);
  }
  if (!response.ok) throw refused(url, response);
  try {
    return await response[kind]();
  } catch (fault) {
    if (fault instanceof RangeError) throw notRun(url, Number(response.headers.get("content-length")), fault);
    throw kind === "json" ? damaged(`${url} is no JSON (${fault.message})`, fault) : unreachable(url, fault);
  }
}

/** The content of a .gz file, also from servers that unpack it themselves. */
export async function unpacked(url) {
  const content = await load(url, "arrayBuffer");
  const [first, second] = new Uint8Array(content, 0, Math.min(2, content.byteLength));
  if (first !== 0x1f || second !== 0x8b) return content;
  try {
    const stream = new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"));
    return await new Response(stream).arrayBuffer();
  } catch (fault) {
    if (fault instanceof RangeError) throw notRun(url, content.byteLength, fault);
    throw damaged(`${url} is damaged`, fault);
  }
}
