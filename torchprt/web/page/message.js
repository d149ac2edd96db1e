// A classic script: it runs, and can complain, where modules do not.
"use strict";

/** Shows one sentence of what is wrong and one of what to do, over the picture. The first fault stays. */
function complain(title, text) {
  if (document.readyState === "loading") {
    document.addEventListener("DOMContentLoaded", () => complain(title, text));
    return;
  }
  const box = document.getElementById("message");
  if (!box.hidden) return;
  box.querySelector("h2").textContent = title;
  box.querySelector("p").textContent = text;
  box.hidden = false;
  document.getElementById("loading").hidden = true;
}

window.complain = complain;
const onDisk = () =>
  complain(
    "This page needs a web server",
    "Browsers do not let a page read the files beside it from a disk. Put the folder on any static web server, or run: " +
      "torchprt serve FOLDER",
  );

// What is too old for this cannot run the modules either, and would say something else of it.
if (!(HTMLScriptElement.supports && HTMLScriptElement.supports("importmap"))) {
  complain(
    "This browser is too old for this page",
    "It knows no import maps, which came in 2022 and 2023. Use a current Firefox, Chrome, Edge or Safari.",
  );
}
// What a script or module that is missing reports does not rise to the window, but can be caught on its way down.
window.addEventListener(
  "error",
  (event) => {
    if (location.protocol === "file:") return onDisk();
    const script = event.target instanceof HTMLScriptElement;
    if (!script && !event.message) return;
    const what = script
      ? `${event.target.src}, or a module that it imports, could not be loaded`
      : `${event.filename}: ${event.message}`;
    complain(
      "This page is not complete",
      `${what}. Copy the whole folder to the server again; if it still fails, write the page again with torchprt export --web.`,
    );
  },
  true,
);
window.addEventListener("unhandledrejection", (event) => {
  const { title, message } = event.reason || {};
  if (title) complain(title, message);
  else complain("The page stopped", `${message || event.reason}. Load it again.`);
});
document.addEventListener("DOMContentLoaded", () => {
  document.getElementById("loading").hidden = !document.getElementById("message").hidden;
});
