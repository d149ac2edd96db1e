// A classic script: it runs, and can complain, where modules do not.
"use strict";

/** Shows one sentence of what is wrong and one of what to do, over the picture. The first fault stays. */
function complain(title, text) {
  const box = document.getElementById("message");
  if (!box.hidden) return;
  box.querySelector("h2").textContent = title;
  box.querySelector("p").textContent = text;
  box.hidden = false;
  document.getElementById("loading").hidden = true;
}

window.complain = complain;
window.addEventListener("DOMContentLoaded", () => {
  if (location.protocol === "file:") {
    complain(
      "This page needs a web server",
      "Browsers do not let a page read the files beside it from a disk. Put the folder on any static web server, or " +
        "run: torchprt serve FOLDER",
    );
  }
});
// A script or module that is missing reports to itself alone: the event does not rise, but it can be caught.
window.addEventListener(
  "error",
  (event) => {
    const source = event.target instanceof HTMLScriptElement ? event.target.src : event.filename;
    if (event.target instanceof HTMLImageElement) return;
    complain("This page is not complete", `${source || "a script"}: ${event.message || "could not be loaded"}. Write the page again with torchprt export --web.`);
  },
  true,
);
window.addEventListener("unhandledrejection", (event) => {
  complain("The page stopped", `${event.reason?.message ?? event.reason}`);
});
