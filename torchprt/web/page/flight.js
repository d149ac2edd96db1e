// An object that moves over the model and casts its shadow on it.
import { Matrix4, Quaternion, Vector3 } from "three";
import { unshadowed } from "./modes.js";

const GUARD = 1e-3;

export class Flight {
  /** `shadow`: the graph of what the object does to light around it; `model`: that of the object, whose mesh is drawn. */
  constructor({ poses, seconds }, shadow, model, mesh) {
    Object.assign(this, { seconds, shadow, model, mesh });
    this.poses = poses.map((pose) => {
      const [place, turn, size] = [new Vector3(), new Quaternion(), new Vector3()];
      new Matrix4().set(...pose).decompose(place, turn, size);
      return { place, turn };
    });
    this.moment = 0;
    this.flying = false;
  }

  /** Goes on for some seconds. */
  pass(seconds) {
    this.moment = (this.moment + seconds / this.seconds) % 1;
  }

  /** Where the object is: a Matrix4. From the last pose it is put back to the first. */
  get pose() {
    const at = this.moment * (this.poses.length - 1);
    const [one, two] = [Math.floor(at), Math.min(Math.floor(at) + 1, this.poses.length - 1)];
    const place = this.poses[one].place.clone().lerp(this.poses[two].place, at - one);
    const turn = this.poses[one].turn.clone().slerp(this.poses[two].turn, at - one);
    return new Matrix4().compose(place, turn, new Vector3(1, 1, 1));
  }

  /** The radiance of the object under a light turned by the row-major `rotation`, and that of the receivers below it. */
  async shade(light, rotation, receivers, radiance) {
    const e = this.pose.elements;
    const turn = [e[0], e[4], e[8], e[1], e[5], e[9], e[2], e[6], e[10]];
    const seen = await this.model.shade(light, product(turn, rotation), [0, 0, 0]);
    const count = receivers.normals.length / 3;
    const plain = this.#plain(light, rotation, receivers.normals);
    const left = await this.shadow.shade(light, rotation, [0, 0, 0], {
      positions: [receivers.geometry.attributes.position.array, [count, 3]],
      normals: [receivers.normals, [count, 3]],
      pose: [Float32Array.from([...turn.slice(0, 3), e[12], ...turn.slice(3, 6), e[13], ...turn.slice(6), e[14], 0, 0, 0, 1]), [1, 4, 4]],
    });
    return { seen, below: ratio(radiance, left, plain) };
  }

  /** What white receivers reflect of the plain light; kept, because the light stands still while the object flies. */
  #plain(light, rotation, normals) {
    if (this.kept?.light !== light || this.kept.rotation !== String(rotation)) {
      const albedo = new Float32Array(normals.length).fill(1);
      const values = unshadowed({ normals, albedo }, light, rotation);
      this.kept = { light, rotation: String(rotation), values };
    }
    return this.kept.values;
  }
}

/** Row-major `A^T B`. */
function product(a, b) {
  const made = [];
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) made.push(a[i] * b[j] + a[3 + i] * b[3 + j] + a[6 + i] * b[6 + j]);
  }
  return made;
}

/** `radiance` times what is `left` of the `plain` light; 1 where there is next to none. As `shade.by_ratio`. */
export function ratio(radiance, left, plain) {
  let largest = 0;
  for (const value of plain) largest = Math.max(largest, Math.abs(value));
  const least = (GUARD * largest) ** 2 + 1e-30;
  return radiance.map((value, i) => value * (1 + ((left[i] - plain[i]) * plain[i]) / (plain[i] * plain[i] + least)));
}
