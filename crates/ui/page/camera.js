// The camera of the room: it orbits a target. Nothing but the user and the named views moves it.
import * as THREE from "./vendor/three.module.min.js";

// A narrow angle: the wall of mirrors at the back appears as large as the users in front.
const FOV_DEG = 22;
const TURN_RAD = 0.12;
const RAD_PER_PIXEL = 0.006;
const ELEVATION = { min: -0.15, max: 1.52 };
// Part of the picture that the room fills, and steps of the search for its place.
const FILLED = 0.98;
const FIT_ROUNDS = 12;
// Time constant of the change to a named view, in s.
const EASE_S = 0.15;

export class OrbitCamera {
  constructor(element, bounds, moved) {
    this.element = element;
    this.bounds = bounds;
    this.moved = moved;
    this.camera = new THREE.PerspectiveCamera(FOV_DEG, 1, 0.05, 400);
    this.camera.up.set(0, 0, 1);
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.aspect = 1;
    this.pointers = new Map();
    this.isChosen = false;
    this.look("wall", true);
    element.addEventListener("pointerdown", (event) => this.press(event));
    element.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("keydown", (event) => this.key(event));
  }

  // Shows the room from a named view. All views are relative to the wall of mirrors.
  look(name, at_once = false) {
    this.name = name;
    this.goal = this.fitting(this.bounds.views[name]);
    this.isAtGoal = false;
    if (at_once || this.still.matches) this.arrive();
    this.moved();
  }

  // The nearest goal in this direction with every corner of the room in the middle of the picture.
  fitting({ azimuth, elevation }) {
    const toEye = direction(azimuth, elevation);
    const right = new THREE.Vector3(-Math.sin(azimuth), Math.cos(azimuth), 0);
    const up = toEye.clone().cross(right);
    const tan = Math.tan(THREE.MathUtils.degToRad(FOV_DEG / 2)) * FILLED;
    const target = new THREE.Vector3(0, 0, 0.5);
    let distance = this.bounds.distance.max;
    for (let round = 0; round < FIT_ROUNDS; round++) {
      // Bounds of the room in the picture, as multiples of its half sides.
      const [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
      for (const corner of this.bounds.corners) {
        const offset = new THREE.Vector3(...corner).sub(target);
        const depth = distance - offset.dot(toEye);
        [offset.dot(right) / (depth * tan * this.aspect), offset.dot(up) / (depth * tan)].forEach((at, axis) => {
          low[axis] = Math.min(low[axis], at);
          high[axis] = Math.max(high[axis], at);
        });
      }
      target.addScaledVector(right, 0.5 * (low[0] + high[0]) * distance * tan * this.aspect);
      target.addScaledVector(up, 0.5 * (low[1] + high[1]) * distance * tan);
      distance *= Math.max(high[0] - low[0], high[1] - low[1]) / 2;
    }
    return { azimuth, elevation, distance, target };
  }

  resize(width, height) {
    this.aspect = width / Math.max(1, height);
    this.camera.aspect = this.aspect;
    this.camera.updateProjectionMatrix();
    // A view that the user has chosen keeps its distance.
    if (!this.isChosen) this.look(this.name, true);
  }

  // Moves towards the goal; returns whether the camera is moving.
  step(seconds) {
    if (this.isAtGoal) return false;
    const share = 1 - Math.exp(-seconds / EASE_S);
    const [now, goal] = [this.now, this.goal];
    const turn = Math.atan2(Math.sin(goal.azimuth - now.azimuth), Math.cos(goal.azimuth - now.azimuth));
    now.azimuth += share * turn;
    now.elevation += share * (goal.elevation - now.elevation);
    now.distance += share * (goal.distance - now.distance);
    now.target.lerp(goal.target, share);
    const rest = Math.abs(turn) + Math.abs(goal.elevation - now.elevation) + Math.abs(goal.distance - now.distance) + now.target.distanceTo(goal.target);
    if (rest < 2e-3) this.arrive();
    else this.place();
    return true;
  }

  arrive() {
    this.now = { ...this.goal, target: this.goal.target.clone() };
    this.isAtGoal = true;
    this.place();
  }

  place() {
    const { azimuth, elevation, distance, target } = this.now;
    this.camera.position.copy(target).addScaledVector(direction(azimuth, elevation), distance);
    this.camera.lookAt(target);
  }

  // The state of the camera, for tests and for the drawing.
  get eye() {
    return this.camera.position.toArray();
  }

  turn(azimuth, elevation, zoom) {
    const { min, max } = this.bounds.distance;
    const now = this.now;
    this.goal = {
      azimuth: now.azimuth + azimuth, target: now.target.clone(),
      elevation: THREE.MathUtils.clamp(now.elevation + elevation, ELEVATION.min, ELEVATION.max),
      distance: THREE.MathUtils.clamp(now.distance * zoom, min, max),
    };
    this.isChosen = true;
    this.arrive();
    this.moved();
  }

  press(event) {
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  // One pointer turns the view, two zoom it.
  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const here = [event.clientX, event.clientY];
    if (this.pointers.size === 1) this.turn(-RAD_PER_PIXEL * (here[0] - before[0]), RAD_PER_PIXEL * (here[1] - before[1]), 1);
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
      const apart = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
      this.turn(0, 0, apart(before) / apart(here));
    }
    this.pointers.set(event.pointerId, here);
  }

  // Without the control key the wheel scrolls the page, unless the room has the focus.
  wheel(event) {
    if (!event.ctrlKey && document.activeElement !== this.element) return;
    event.preventDefault();
    this.turn(0, 0, Math.exp(0.0012 * event.deltaY));
  }

  key(event) {
    const steps = {
      ArrowLeft: [-TURN_RAD, 0, 1], ArrowRight: [TURN_RAD, 0, 1], ArrowUp: [0, TURN_RAD, 1], ArrowDown: [0, -TURN_RAD, 1],
      "+": [0, 0, 0.92], "=": [0, 0, 0.92], "-": [0, 0, 1.08],
    };
    const step = steps[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.turn(...step);
  }
}

function direction(azimuth, elevation) {
  return new THREE.Vector3(Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation));
}
