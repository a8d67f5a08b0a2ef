// The room in three dimensions.
import { RedrawLimiter } from "./redraw.js";
import { userColour } from "./page.js";

const EYES = {
  corner: { eye: { x: 1.1, y: -1.62, z: 0.8 }, center: { x: 0.02, y: 0.02, z: -0.14 } },
  wall: { eye: { x: 0, y: -1.75, z: 0.35 }, center: { x: 0, y: 0.1, z: -0.05 } },
  top: { eye: { x: 0, y: -0.05, z: 2.0 }, center: { x: 0, y: 0, z: 0 } },
};
const SIDES = 14;
const UNUSED = "#8a939c";
const UNUSABLE = "#882255";
const LIGHT = { ambient: 0.75, diffuse: 0.4, specular: 0.1, roughness: 0.8 };

export class Room {
  constructor(element, plan) {
    this.element = element;
    this.plan = plan;
    this.isDragged = false;
    this.redraw = new RedrawLimiter(180);
    element.addEventListener("pointerdown", () => { this.isDragged = true; });
    addEventListener("pointerup", () => { this.isDragged = false; });
    element.addEventListener("keydown", (event) => this.turn(event));
    for (const button of document.querySelectorAll("[data-eye]")) {
      button.addEventListener("click", () => this.look(EYES[button.dataset.eye]));
    }
    document.getElementById("legend").innerHTML =
      `<i style="background:${UNUSED}"></i>mirror without a user <i style="background:${UNUSABLE}"></i>unusable mirror ` +
      `<i style="background:#000;opacity:.45"></i>area without direct light, at the height of the detectors <i style="background:#f0c000"></i>direct path. ` +
      "A mirror has the colour of the user that it serves.";
  }

  theme(dark) {
    this.floor = dark ? "#4a545f" : "#dfe4e8";
    this.edge = dark ? "#75808c" : "#9aa5b0";
    this.ink = dark ? "#e9ecef" : "#1a1e23";
    this.dark = dark;
    this.redraw.reset();
  }

  update(frame) {
    // A redraw while the user drags would reset the camera.
    if (!this.isDragged) this.redraw.run(() => this.draw(frame));
  }

  draw(frame) {
    const traces = [
      this.box(), this.ground(), this.blockedAreas(frame), this.obstacles(frame), this.bodies(frame), this.leds(), ...this.direct(frame),
      this.beams(frame), this.mirrors(frame), this.detectors(frame),
    ];
    const axis = (half, from = -half) => ({ visible: false, range: [from, half], autorange: false });
    const [x, y, z] = this.plan.size_m;
    const layout = {
      margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, paper_bgcolor: "rgba(0,0,0,0)", uirevision: "kept",
      scene: {
        xaxis: axis(x / 2), yaxis: axis(y / 2), zaxis: axis(z, 0), aspectmode: "data", dragmode: "orbit", camera: EYES.corner,
        uirevision: "kept",
      },
    };
    Plotly.react(this.element, traces, layout, { displayModeBar: false, responsive: true });
  }

  look(camera) {
    Plotly.relayout(this.element, { "scene.camera": camera });
  }

  // Arrow keys rotate the view, plus and minus zoom.
  turn(event) {
    const steps = { ArrowLeft: [-0.12, 0, 1], ArrowRight: [0.12, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1], "+": [0, 0, 0.92], "-": [0, 0, 1.08] };
    const step = steps[event.key];
    if (!step || !this.element.layout) return;
    event.preventDefault();
    const { eye, center } = this.element.layout.scene.camera;
    const length = Math.hypot(eye.x, eye.y, eye.z) * step[2];
    const about = Math.atan2(eye.y, eye.x) + step[0];
    const above = Math.min(1.5, Math.max(-0.2, Math.asin(eye.z / Math.hypot(eye.x, eye.y, eye.z)) + step[1]));
    const turned = { x: length * Math.cos(above) * Math.cos(about), y: length * Math.cos(above) * Math.sin(about), z: length * Math.sin(above) };
    this.look({ eye: turned, center });
  }

  box() {
    const [x, y, z] = this.plan.size_m;
    const points = [];
    for (const height of [0, z]) {
      for (const [sx, sy] of [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) points.push([(sx * x) / 2, (sy * y) / 2, height]);
      points.push(null);
    }
    for (const [sx, sy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) points.push([(sx * x) / 2, (sy * y) / 2, 0], [(sx * x) / 2, (sy * y) / 2, z], null);
    return lines(points, { color: this.edge, width: 2 });
  }

  ground() {
    const [x, y] = this.plan.size_m;
    const mesh = new Mesh();
    mesh.fan([[-x / 2, -y / 2, 0], [x / 2, -y / 2, 0], [x / 2, y / 2, 0], [-x / 2, y / 2, 0]], this.floor);
    return mesh.trace();
  }

  blockedAreas(frame) {
    const mesh = new Mesh();
    for (const corners of frame.blocked_areas_m) mesh.fan(corners.map(([x, y]) => [x, y, this.plan.detector_height_m]), "#000000");
    return mesh.trace({ opacity: this.dark ? 0.5 : 0.3 });
  }

  obstacles(frame) {
    const mesh = new Mesh();
    for (const cylinder of frame.obstacles_m) mesh.cylinder(cylinder, this.dark ? "#9aa5b0" : "#7c8792");
    return mesh.trace({ opacity: 0.9 });
  }

  bodies(frame) {
    const mesh = new Mesh();
    frame.users.forEach(({ body_m }, index) => { if (body_m) mesh.cylinder(body_m, userColour(index)); });
    return mesh.trace({ opacity: 0.75 });
  }

  leds() {
    const [x, y, z] = columns(this.plan.leds_m);
    return {
      type: "scatter3d", mode: "markers", x, y, z, hovertemplate: "LED<extra></extra>",
      marker: { size: 9, symbol: "square", color: "#f0c000", line: { color: this.ink, width: 1 } },
    };
  }

  direct(frame) {
    const path = ({ led, at_m }) => [this.plan.leds_m[led], at_m, null];
    const clear = frame.users.filter((user) => !user.blocked).flatMap(path);
    const blocked = frame.users.filter((user) => user.blocked).flatMap(path);
    return [lines(clear, { color: "#f0c000", width: 5 }), lines(blocked, { color: this.edge, width: 2, dash: "dash" })];
  }

  beams(frame) {
    const points = [];
    const color = [];
    frame.serves.forEach((user, mirror) => {
      if (user < 0) return;
      points.push(this.plan.mirrors_m[mirror], frame.users[user].at_m, null);
      color.push(userColour(user), userColour(user), userColour(user));
    });
    return { ...lines(points, { color, width: 2 }), opacity: 0.45 };
  }

  mirrors(frame) {
    const mesh = new Mesh();
    const unusable = new Set(frame.unusable);
    frame.mirrors_m.forEach((corners, index) => {
      const user = frame.serves[index];
      const colour = unusable.has(index) ? UNUSABLE : user < 0 ? UNUSED : userColour(user);
      mesh.fan([0, 3, 6, 9].map((at) => corners.slice(at, at + 3)), colour);
    });
    return mesh.trace({ lighting: { ...LIGHT, specular: 0.4 } });
  }

  detectors(frame) {
    const [x, y, z] = columns(frame.users.map((user) => user.at_m));
    return {
      type: "scatter3d", mode: "markers+text", x, y, z, text: frame.users.map((_, index) => `<b>${index}</b>`),
      textposition: "top center", textfont: { color: this.ink, size: 14 }, hovertemplate: "user %{text}<extra></extra>",
      marker: { size: 6, color: frame.users.map((_, index) => userColour(index)), line: { color: this.ink, width: 1 } },
    };
  }
}

// Triangles, each with a colour.
class Mesh {
  constructor() { this.points = []; this.faces = []; this.colours = []; }

  // A convex polygon.
  fan(corners, colour) {
    const first = this.points.push(...corners) - corners.length;
    for (let corner = 1; corner + 1 < corners.length; corner++) {
      this.faces.push([first, first + corner, first + corner + 1]);
      this.colours.push(colour);
    }
  }

  // An upright cylinder on the floor, with its lid.
  cylinder([x, y, radius, height], colour) {
    const ring = (z) => Array.from({ length: SIDES }, (_, side) => {
      const angle = (2 * Math.PI * side) / SIDES;
      return [x + radius * Math.cos(angle), y + radius * Math.sin(angle), z];
    });
    const [low, high] = [ring(0), ring(height)];
    low.forEach((corner, side) => {
      const next = (side + 1) % SIDES;
      this.fan([corner, low[next], high[next], high[side]], colour);
    });
    this.fan(high, colour);
  }

  trace(extra) {
    const [x, y, z] = columns(this.points);
    const [i, j, k] = columns(this.faces);
    return { type: "mesh3d", x, y, z, i, j, k, facecolor: this.colours, flatshading: true, lighting: LIGHT, hoverinfo: "skip", ...extra };
  }
}

function columns(points) {
  return [0, 1, 2].map((axis) => points.map((point) => point?.[axis] ?? null));
}

function lines(points, line) {
  const [x, y, z] = columns(points);
  return { type: "scatter3d", mode: "lines", x, y, z, line, hoverinfo: "skip", connectgaps: false };
}
