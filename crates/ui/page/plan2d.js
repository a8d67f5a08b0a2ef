// The room from above on a canvas, for browsers without WebGL.
import { LIGHT, headingMark, mirrorColour, palette, userColour, wallsOf } from "./geometry.js";
import { heatPixels } from "./heat.js";

const MARGIN = 0.3;

export class Plan2D {
  constructor(element, plan) {
    this.plan = plan;
    this.element = element;
    this.canvas = document.createElement("canvas");
    element.append(this.canvas);
    element.setAttribute("aria-label", "The room from above");
    this.brush = this.canvas.getContext("2d");
    this.heat = null;
  }

  theme(dark) {
    this.colours = palette(dark);
  }

  resize() {
    const { clientWidth, clientHeight } = this.element;
    const ratio = devicePixelRatio || 1;
    [this.canvas.width, this.canvas.height] = [clientWidth * ratio, clientHeight * ratio];
    [this.canvas.style.width, this.canvas.style.height] = [`${clientWidth}px`, `${clientHeight}px`];
    const [x, y] = this.plan.size_m;
    this.scale = Math.min(this.canvas.width / (x + 2 * MARGIN), this.canvas.height / (y + 2 * MARGIN));
  }

  look() {}

  step() {
    return false;
  }

  setHeat(map) {
    this.heat = map && document.createElement("canvas");
    if (!map) return;
    [this.heat.width, this.heat.height] = [map.columns, map.rows];
    const pixels = new ImageData(new Uint8ClampedArray(heatPixels(map)), map.columns, map.rows);
    this.heat.getContext("2d").putImageData(pixels, 0, 0);
  }

  // In this drawing, x and y are in m, and y points up.
  draw(frame, paths, shown) {
    const { brush, colours } = this;
    const [x, y] = this.plan.size_m;
    brush.setTransform(1, 0, 0, 1, 0, 0);
    brush.clearRect(0, 0, this.canvas.width, this.canvas.height);
    brush.setTransform(this.scale, 0, 0, -this.scale, this.canvas.width / 2, this.canvas.height / 2);
    brush.fillStyle = colours.floor;
    brush.fillRect(-x / 2, -y / 2, x, y);
    if (this.heat && shown.heat) brush.drawImage(this.heat, -x / 2, -y / 2, x, y);
    brush.lineWidth = 0.03;
    brush.strokeStyle = colours.edge;
    brush.strokeRect(-x / 2, -y / 2, x, y);
    if (!frame) return;
    if (!shown.heat) for (const corners of frame.blocked_areas_m) this.polygon(corners, colours.shade, 0.2);
    for (const [ox, oy, radius] of frame.obstacles_m) this.disc([ox, oy], radius, colours.obstacle, 1);
    if (shown.paths) this.paths(paths);
    this.light(frame, shown);
    if (shown.wall) this.mirrors(frame);
    for (const user of frame.users) this.user(user, shown);
    for (const led of this.plan.leds_m) this.disc(led, 0.12, LIGHT, 1);
  }

  light(frame, shown) {
    if (shown.beams && shown.wall) {
      frame.serves.forEach((index, mirror) => {
        const user = frame.users[index];
        if (user) this.line([this.plan.mirrors_m[mirror], user.at_m], userColour(user.user), 0.012, 0.4);
      });
    }
    for (const user of frame.users) {
      const led = this.plan.leds_m[user.led];
      if (!led) continue;
      // A path that no process reports is not drawn.
      if (user.blocked === true) this.line([led, user.at_m], this.colours.blocked, 0.02, 1, [0.08, 0.08]);
      else if (user.blocked === false) this.line([led, user.at_m], LIGHT, 0.03, 1);
    }
  }

  // Mirrors of one column lie above each other, so each is drawn a little farther from the wall.
  mirrors(frame) {
    const unusable = new Set(frame.unusable);
    let first = 0;
    wallsOf(this.plan).forEach(({ centre, inward, up }, array) => {
      const lowest = centre[2] - up / 2;
      const [start, end] = [first, (first += this.plan.arrays[array])];
      this.plan.mirrors_m.slice(start, end).forEach(([mx, my, mz], index) => {
        const out = 0.02 + (up > 0 ? (0.24 * (mz - lowest)) / up : 0);
        const at = [mx - out * inward[0], my - out * inward[1]];
        this.disc(at, 0.03, mirrorColour(frame, start + index, unusable), 1);
      });
    });
  }

  user(user, shown) {
    const colour = userColour(user.user);
    if (user.body_m) this.disc(user.body_m, user.body_m[2], colour, 0.45);
    this.disc(user.at_m, 0.08, colour, 1);
    if (user.belief && shown.belief) this.belief(user.belief, colour);
    const lost = !shown.wall && user.without_mirrors_mbps < user.min_rate_mbps;
    this.text(lost ? `${user.user} ✕` : String(user.user), [user.at_m[0] + 0.1, user.at_m[1] + 0.1]);
  }

  // Text has a size in pixels, and stands upright.
  text(text, [x, y]) {
    const { brush } = this;
    brush.save();
    brush.setTransform(1, 0, 0, 1, this.canvas.width / 2 + this.scale * x, this.canvas.height / 2 - this.scale * y);
    brush.font = `bold ${15 * (devicePixelRatio || 1)}px system-ui, sans-serif`;
    brush.fillStyle = this.colours.ink;
    brush.fillText(text, 0, 0);
    brush.restore();
  }

  belief(belief, colour) {
    const { at_m, semi_axes_m, angle_rad } = belief;
    this.line(headingMark(belief), colour, 0.03, 1);
    this.brush.beginPath();
    this.brush.ellipse(at_m[0], at_m[1], semi_axes_m[0], semi_axes_m[1], angle_rad, 0, 2 * Math.PI);
    this.brush.strokeStyle = colour;
    this.brush.stroke();
  }

  paths(paths) {
    for (const [user, points] of paths) this.line(points.map(([, x, y]) => [x, y]), userColour(user), 0.04, 0.9);
  }

  disc([x, y], radius, colour, opacity) {
    this.brush.globalAlpha = opacity;
    this.brush.fillStyle = colour;
    this.brush.beginPath();
    this.brush.arc(x, y, radius, 0, 2 * Math.PI);
    this.brush.fill();
    this.brush.globalAlpha = 1;
  }

  polygon(corners, colour, opacity) {
    this.brush.globalAlpha = opacity;
    this.brush.fillStyle = colour;
    this.brush.beginPath();
    corners.forEach(([x, y]) => this.brush.lineTo(x, y));
    this.brush.fill();
    this.brush.globalAlpha = 1;
  }

  line(points, colour, width, opacity, dash = []) {
    this.brush.globalAlpha = opacity;
    this.brush.strokeStyle = colour;
    this.brush.lineWidth = width;
    this.brush.setLineDash(dash);
    this.brush.beginPath();
    points.forEach(([x, y]) => this.brush.lineTo(x, y));
    this.brush.stroke();
    this.brush.setLineDash([]);
    this.brush.globalAlpha = 1;
  }
}
