// The picture of the room in 3-D: renderer, camera and resolution.
import * as THREE from "./vendor/three.module.min.js";
import { OrbitCamera } from "./camera.js";
import { RoomScene } from "./scene.js";

// On a slow machine the picture gets coarser instead of rarer: time between two pictures in s.
const SLOW_S = 0.07;
const FAST_S = 0.03;
const RATIO_MIN = 0.75;
const JUDGE_AFTER = 12;

export class View3D {
  // `null` if the browser has no WebGL. Without a graphics card the edges are not smoothed, because that costs much.
  static create(element, plan, bounds, changed) {
    const canvas = document.createElement("canvas");
    const context =
      canvas.getContext("webgl2", { antialias: true, failIfMajorPerformanceCaveat: true, alpha: true }) ??
      canvas.getContext("webgl2", { antialias: false, alpha: true });
    return context && new View3D(element, plan, bounds, changed, new THREE.WebGLRenderer({ canvas, context }));
  }

  constructor(element, plan, bounds, changed, renderer) {
    this.element = element;
    this.renderer = renderer;
    this.content = new RoomScene(plan);
    this.orbit = new OrbitCamera(element, bounds, changed);
    this.ratioMax = Math.min(2, devicePixelRatio || 1);
    this.ratio = this.ratioMax;
    this.renderer.setPixelRatio(this.ratio);
    this.spent = { seconds: 0, pictures: 0 };
    element.append(renderer.domElement);
    renderer.domElement.addEventListener("webglcontextrestored", changed);
  }

  theme(dark) {
    this.content.theme(dark);
  }

  resize() {
    const { clientWidth, clientHeight } = this.element;
    this.renderer.setSize(clientWidth, clientHeight);
    this.orbit.resize(clientWidth, clientHeight);
  }

  look(name) {
    this.orbit.isChosen = true;
    this.orbit.look(name);
  }

  step(seconds) {
    return this.orbit.step(seconds);
  }

  setHeat(map) {
    this.content.setHeat(map);
  }

  // Position of the camera in m, for tests.
  get eye() {
    return this.orbit.eye;
  }

  draw(frame, paths, shown, seconds) {
    if (frame) this.content.place(frame, paths, shown);
    this.content.separateLabels(this.orbit.camera);
    // A change of the resolution clears the picture, so it comes first.
    this.judge(seconds);
    this.renderer.render(this.content.scene, this.orbit.camera);
  }

  // Adapts the resolution to the speed of the machine.
  judge(seconds) {
    if (seconds === 0) return;
    this.spent.seconds += seconds;
    this.spent.pictures += 1;
    if (this.spent.pictures < JUDGE_AFTER) return;
    const mean = this.spent.seconds / this.spent.pictures;
    this.spent = { seconds: 0, pictures: 0 };
    const ratio = mean > SLOW_S ? this.ratio * 0.85 : mean < FAST_S ? this.ratio * 1.1 : this.ratio;
    const bounded = Math.min(this.ratioMax, Math.max(RATIO_MIN, ratio));
    if (bounded === this.ratio) return;
    this.ratio = bounded;
    this.renderer.setPixelRatio(bounded);
  }
}
