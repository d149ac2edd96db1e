// The panel beside the picture: what is chosen, and what the page says about itself.
import { choices } from "./choices.js";
import { TONES } from "./display.js";
import { readImage } from "./image.js";
import { lightOf } from "./light.js";
import { listen } from "./pointer.js";
import { extremes, WINDOWS } from "./windows.js";

const at = (id) => document.getElementById(id);
const number = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
const labels = {
  neutral: "Khronos neutral",
  agx: "AgX",
  filmic: "Filmic",
  none: "None",
};
const windows = {
  none: "None",
  hann: "Hann",
  lanczos: "Lanczos",
  gauss: "Gauss",
  least: "Nothing negative",
  auto: "As little as helps",
};

export const megabytes = (bytes) => `${(bytes / 2 ** 20).toFixed(bytes < 2 ** 20 ? 2 : 1)} MB`;
export const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

/** Writes what the viewer shows and how fast it is. */
export function report(viewer) {
  const { about, model, compressed } = viewer;
  const rows = [
    [about.volume ? "cells" : about.map ? "texels" : "vertices", number(about.vertices)],
    ["transfer", megabytes(about.bytes)],
    ...(compressed ? [["compressed", megabytes(about.compressed.bytes)]] : []),
    ["model file", megabytes(model.bytes)],
    ["one shade", viewer.times.length ? `${median(viewer.times).toFixed(1)} ms` : "-"],
    ["runs on", { wasm: "WASM, 1 thread", webgpu: "WebGPU", webgl: "WebGL 2" }[model.where]],
    ...(viewer.relative === null ? [] : [["difference (RMS)", `${(100 * viewer.relative).toPrecision(2)} %`]]),
  ];
  const text = rows.flat().join("\n");
  const list = at("statistics");
  if (list.dataset.text === text) return;
  list.dataset.text = text;
  list.replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [term, definition] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = name;
      definition.textContent = value;
      return [term, definition];
    }),
  );
}

/** Says something about what was just done; screen readers read it out. */
function note(words) {
  at("note").textContent = words;
  at("note").hidden = !words;
}

/** Connects the panel, the canvas and files that are dropped with the viewer. */
export function connect(viewer) {
  viewer.ondraw = () => report(viewer);
  lights(viewer);
  modes(viewer);
  looks(viewer);
  turning(viewer);
  if (viewer.flight) flying(viewer);
  else for (const id of ["flying-row", "moment-row"]) at(id).remove();
  files(viewer);
  listen(viewer.view.canvas, {
    camera: (right, down) => viewer.turnCamera(right, down),
    light: (right, down) => viewer.turnLight(right, down),
    zoom: (factor) => viewer.zoom(factor),
    play: () => at("turning").click(),
  });
  at("controls").hidden = false;
}

function lights(viewer) {
  const { about, pictures } = viewer;
  choices(
    at("environments"),
    about.environments.map((each, index) => {
      const name = document.createElement("span");
      name.textContent = each.name;
      pictures[index].setAttribute("alt", "");
      pictures[index].setAttribute("aria-hidden", "true");
      return [index, pictures[index], name];
    }),
    viewer.environment,
    (index) => {
      viewer.environment = index;
      note("");
      return viewer.change();
    },
  );
}

function modes(viewer) {
  const { about } = viewer;
  const entries = [
    ["lambert", "N\u00b7L", "one lamp, no shadows"],
    ["unshadowed", "Irradiance", "the whole light, no shadows"],
    ["transfer", "Transfer", about.transport],
    ...(about.compressed ? [["compressed", "Compressed", about.compressed.what]] : []),
    ["difference", "Difference", about.compressed ? "compressed from transfer" : "irradiance from transfer"],
  ];
  // A volume has no normals.
  const possible = entries.filter(([value]) => !about.volume || ["transfer", "compressed"].includes(value));
  choices(
    at("modes"),
    possible.map(([value, name, what]) => {
      const small = document.createElement("small");
      small.textContent = what;
      return [value, name, small];
    }),
    viewer.mode,
    (mode) => {
      viewer.mode = mode;
      viewer.times = [];
      at("legend").hidden = mode !== "difference";
      return viewer.change();
    },
  );
  at("legend-value").textContent = `${100 * about.full_scale} % of RMS`;
}

function looks(viewer) {
  const { about } = viewer;
  const range = (name, value, text, set) => {
    const input = at(name);
    const say = () => {
      at(`${name}-value`).textContent = text(Number(input.value));
      input.setAttribute("aria-valuetext", text(Number(input.value)));
    };
    input.value = value;
    input.addEventListener("input", () => {
      set(Number(input.value));
      say();
      shown(viewer);
    });
    say();
  };
  at("order").max = about.order;
  range("order", about.order, (value) => `${value} of ${about.order}`, (value) => (viewer.order = value));
  range("exposure", 0, (value) => `${value > 0 ? "+" : ""}${value.toFixed(1)}`, (value) => (viewer.stops = value));
  const select = (name, values, words, chosen, set) => {
    at(name).replaceChildren(...values.map((value) => new Option(words[value], value, value === chosen, value === chosen)));
    at(name).addEventListener("change", (event) => {
      set(event.target.value);
      shown(viewer);
    });
  };
  select("window", WINDOWS, windows, viewer.window, (value) => (viewer.window = value));
  select("tone", TONES, labels, viewer.tone, (value) => (viewer.tone = value));
  at("background").addEventListener("change", (event) => {
    viewer.surrounded = event.target.checked;
    viewer.change();
  });
}

/** Shades again; a light that the window cannot be made for is shown without one, and told. */
function shown(viewer) {
  try {
    viewer.shining;
  } catch (fault) {
    viewer.window = at("window").value = "none";
    note(`No window: ${fault.message}.`);
  }
  viewer.change();
}

function turning(viewer) {
  const box = at("turning");
  box.addEventListener("change", () => viewer.letTurn(box.checked));
  // Nothing moves by itself before it is asked to, and what moves stops when the system is told to keep still.
  matchMedia("(prefers-reduced-motion: reduce)").addEventListener("change", ({ matches }) => {
    if (matches && box.checked) box.click();
  });
}

/** Where the object is on its way, by hand or by itself. */
function flying(viewer) {
  const [box, place] = [at("flying"), at("moment")];
  at("flying-row").hidden = at("moment-row").hidden = false;
  const say = () => {
    const percent = `${Math.round(100 * viewer.flight.moment)} %`;
    at("moment-value").textContent = percent;
    place.setAttribute("aria-valuetext", percent);
  };
  box.addEventListener("change", () => viewer.letFly(box.checked));
  place.addEventListener("input", () => viewer.flyTo(Number(place.value)));
  const before = viewer.ondraw;
  viewer.ondraw = () => {
    before();
    place.value = viewer.flight.moment;
    say();
  };
  matchMedia("(prefers-reduced-motion: reduce)").addEventListener("change", ({ matches }) => {
    if (matches && box.checked) box.click();
  });
  say();
}

/** Files from the button, and those that are dropped anywhere on the page. */
function files(viewer) {
  const input = at("file");
  input.addEventListener("change", () => {
    if (input.files.length) open(viewer, input.files);
    input.value = "";
  });
  const holdsFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  let inside = 0;
  const hover = (change) => (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    inside = Math.max(0, inside + change);
    at("drop").hidden = inside === 0;
  };
  addEventListener("dragenter", hover(1));
  addEventListener("dragleave", hover(-1));
  addEventListener("dragover", hover(0));
  addEventListener("drop", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    inside = 0;
    at("drop").hidden = true;
    open(viewer, event.dataTransfer.files);
  });
}

async function open(viewer, opened) {
  const said = [];
  for (const file of opened) {
    note(`reading ${file.name}`);
    // So that the words are seen before the work begins.
    await new Promise((resolve) => setTimeout(resolve, 20));
    try {
      const image = await readImage(file);
      const light = lightOf(file.name.replace(/\.[^.]+$/, ""), image, viewer.about.order);
      said.push(...image.notes);
      const { least, largest } = extremes(light.coefficients, viewer.about.order);
      if (least < -0.01 * largest) {
        said.push(`${file.name} rings in ${viewer.about.order} bands: a window against ringing takes dark patches away.`);
      }
      await viewer.addLight(light);
      lights(viewer);
    } catch (fault) {
      said.push(fault instanceof RangeError ? `${file.name} is too large for the memory of this browser.` : fault.message);
    }
  }
  note(said.join(" "));
  at("environments").lastElementChild.scrollIntoView({ block: "nearest" });
}
