// The view of the room: takes the frames of the server, and draws them at the rate of the display.
import { Motion } from "./motion.js";
import { LIGHT, UNUSABLE, UNUSED, boundsOf, palette } from "./geometry.js";
import { PAUSE } from "./redraw.js";
import { Plan2D } from "./plan2d.js";
import { ask } from "./requests.js";
import { View3D } from "./view3d.js";

// A machine that needs longer than this for a picture draws fewer, so that orders and the rest of the page stay fast.
const SLOW_MS = 80;
const HEAT_EVERY_MS = 1000;
// A map that is not there by then is given up.
const HEAT_LIMIT_MS = 4000;

export class Room {
  constructor(element, plan) {
    this.element = element;
    this.motion = new Motion();
    this.shown = { wall: true, beams: true, paths: false, heat: false, belief: true };
    this.isDirty = true;
    // Pictures drawn since the start, for tests.
    this.frames = 0;
    this.nextDraw = 0;
    // When the first frame arrived that no picture shows yet, and the first of the picture that is being painted, in ms.
    this.awaiting = this.painting = null;
    const changed = () => { this.isDirty = true; };
    const bounds = boundsOf(plan);
    // Covers the canvas until it has a picture: a browser may show an empty one as black.
    this.awaited = document.getElementById("awaited");
    this.view = View3D.create(element, plan, bounds, changed) ?? new Plan2D(element, plan);
    this.is3D = this.view instanceof View3D;
    document.documentElement.dataset.view = this.is3D ? "3d" : "2d";
    // Tests read the state of the view here.
    element.room = this;
    for (const button of document.querySelectorAll("[data-eye]")) {
      button.hidden = !this.is3D;
      button.addEventListener("click", () => this.view.look(button.dataset.eye));
    }
    for (const name of Object.keys(this.shown)) {
      const input = document.getElementById(`show-${name}`);
      input.checked = this.shown[name];
      input.addEventListener("change", () => this.show(name, input.checked));
    }
    // A new size clears the picture.
    new ResizeObserver(() => { this.view.resize(); this.draw(performance.now(), 0); }).observe(element);
    this.last = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  theme(dark) {
    this.view.theme(dark);
    // The legend has the colours of the picture.
    const { blocked, obstacle } = palette(dark);
    const mark = (name) => document.querySelector(`#legend .${name}`).style;
    mark("blocked").borderColor = blocked;
    for (const [name, colour] of Object.entries({ obstacle, unused: UNUSED, unusable: UNUSABLE, direct: LIGHT })) mark(name).background = colour;
    this.drawChange();
  }

  update(frame) {
    const now = performance.now();
    this.motion.take(frame, now);
    this.awaiting ??= now;
    this.isDirty = true;
  }

  // For how long, in s, the picture lacks a frame that has arrived.
  get pictureAge() {
    const since = this.painting ?? this.awaiting;
    return since === null || !this.awaited.hidden ? 0 : (performance.now() - since) / 1000;
  }

  show(name, isShown) {
    this.shown[name] = isShown;
    this.drawChange();
    if (name === "heat" || name === "wall") this.loadHeat();
    dispatchEvent(new CustomEvent("shown", { detail: this.shown }));
  }

  // The heat map is computed by the server while it is shown, at a low rate.
  async loadHeat() {
    clearTimeout(this.heatTimer);
    const request = (this.heatRequest = {});
    let map = null;
    if (this.shown.heat) {
      try {
        const answer = await ask(`floor.json?mirrors=${this.shown.wall ? 1 : 0}`, HEAT_LIMIT_MS);
        if (answer.ok) map = await answer.json();
      } catch {
        // Without a connection there is no map; the banner says so.
      }
      // The switches may have changed meanwhile.
      if (request !== this.heatRequest) return;
      this.heatTimer = setTimeout(() => this.loadHeat(), HEAT_EVERY_MS);
    }
    this.view.setHeat(map);
    this.isDirty = true;
    dispatchEvent(new CustomEvent("heat", { detail: map }));
  }

  // What the user has changed is drawn at once, also on a machine whose pictures are seconds apart.
  drawChange() {
    if (this.frames > 0) this.draw(performance.now(), 0);
    else this.isDirty = true;
  }

  tick(now) {
    const seconds = Math.min(0.25, (now - this.last) / 1000);
    this.last = now;
    const isTurning = this.view.step(seconds);
    if (now >= this.nextDraw && (this.isDirty || isTurning || this.wasMoving)) {
      // One more picture after the last change shows its end.
      this.wasMoving = this.motion.isMoving(now);
      this.isDirty = false;
      this.painting ??= this.awaiting;
      this.awaiting = null;
      this.draw(now, seconds);
      const begun = performance.now();
      const hasRoom = this.motion.to !== null;
      // The second callback runs after the picture was painted.
      requestAnimationFrame(() => requestAnimationFrame((painted) => {
        if (hasRoom) this.awaited.hidden = true;
        this.painting = null;
        const took = painted - begun;
        this.nextDraw = took > SLOW_MS ? painted + PAUSE * took : 0;
      }));
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  draw(now, seconds) {
    this.view.draw(this.motion.at(now), this.motion.paths, this.shown, seconds);
    this.frames += 1;
  }
}
