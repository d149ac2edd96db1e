"""Writes docs/images/three.png: two baked models in one scene of three.js, as a browser shows it.

    python docs/make/three.py

Needs Chromium and playwright, and npm the first time.
"""

import io
import shutil
import tempfile
import threading
from pathlib import Path

import pictures
from page import FLAGS
from PIL import Image
from playwright.sync_api import sync_playwright

from torchprt import bake, preview, web
from torchprt.scene import Lightmap, load, samples
from torchprt.web import serve

SIZE = {"width": 1200, "height": 600}
SHOW = """async () => {
  const { THREE, renderer, scene, camera, model, lights } = window.torchprt;
  renderer.setAnimationLoop(null);
  const { GLTFLoader } = await import("./libraries/loaders/GLTFLoader.js");
  const { loadPRT } = await import("./torchprt.js");
  const dish = await loadPRT("../dish/", new GLTFLoader());
  const box = (object) => new THREE.Box3().setFromObject(object);
  const tall = box(model.object).getSize(new THREE.Vector3()).y;
  dish.object.scale.setScalar((1.25 * tall) / box(dish.object).getSize(new THREE.Vector3()).x);
  model.object.position.x = -0.75 * tall;
  dish.object.position.x = 0.4 * tall;
  dish.object.position.y += box(model.object).min.y - box(dish.object).min.y;
  scene.add(dish.object);
  scene.background = new THREE.Color(0x15171b);
  for (const each of document.querySelectorAll("select, p")) each.style.display = "none";
  const aspect = renderer.domElement.clientWidth / renderer.domElement.clientHeight;
  const view = new THREE.PerspectiveCamera(28, aspect, 0.01, 100);
  const middle = box(model.object).getCenter(new THREE.Vector3()).setX(0);
  view.position.copy(middle).add(new THREE.Vector3(0, 1.0 * tall, 2.7 * tall));
  view.lookAt(middle);
  for (const each of [model, dish]) {
    each.light = lights[0];
    each.update(renderer, view);
  }
  renderer.render(scene, view);
}"""


def main() -> None:
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        samples.write_painted_vase(folder / "vase.glb", 128)
        vase = bake(load(folder / "vase.glb"), order=5, rays=256, progress=False)
        dish = bake(samples.dish(64), order=5, rays=256, lightmap=Lightmap(size=256, uv="unwrap"), progress=False)
        web.export_three(vase, folder / "vase", asset=preview.find_asset(vase)[0], check=False)
        web.export_three(dish, folder / "dish", check=False)
        # The server wants a page at its root.
        (folder / "index.html").write_text("")
        with serve(folder) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
            tab = browser.new_page(viewport=SIZE)
            tab.goto(f"http://127.0.0.1:{server.server_port}/vase/")
            tab.wait_for_selector("body[data-ready]", timeout=60_000)
            tab.evaluate(SHOW)
            picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
            browser.close()
            server.shutdown()
    picture.save(pictures.FOLDER / "three.png", optimize=True)


if __name__ == "__main__":
    main()
