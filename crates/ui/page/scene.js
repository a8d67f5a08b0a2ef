// The objects of the room in 3-D, by three.js. `place` moves them to a frame; nothing is created for each frame.
import * as THREE from "./vendor/three.module.min.js";
import { LIGHT, UNUSED, cornersOf, headingMark, mirrorColour, palette, userColour, wallsOf } from "./geometry.js";
import { Label, separateSprites } from "./labels.js";
import { BELIEF_Z_M, Lines, Tubes, ellipse, fan, heatTexture } from "./shapes.js";

const BODY_OPACITY = 0.45;

export class RoomScene {
  constructor(plan) {
    this.plan = plan;
    this.scene = new THREE.Scene();
    this.ambient = new THREE.HemisphereLight(0xffffff, 0xb8b8b8, 2.1);
    this.sun = new THREE.DirectionalLight(0xffffff, 1.3);
    this.scene.add(this.ambient, this.sun);
    this.shell();
    this.array();
    this.leds();
    this.users = new Map();
    this.obstacles = new THREE.Group();
    this.shades = new THREE.Group();
    this.heat = this.heatPlane();
    this.direct = new Tubes({ radius: 0.014, opacity: 0.9 });
    this.dashed = new Lines({ opacity: 1, dash: 0.08 });
    this.beams = new Lines({ opacity: 0.5 });
    this.paths = new Tubes({ radius: 0.018 });
    this.headings = new Tubes({ radius: 0.016 });
    this.scene.add(this.obstacles, this.shades, this.heat, this.direct.object, this.dashed.object, this.beams.object, this.paths.object, this.headings.object);
    this.obstacleKey = this.shadeKey = "";
  }

  theme(dark) {
    this.colours = palette(dark);
    const { floor, wall, side } = this.colours;
    [side, side, wall, wall, wall, floor].forEach((colour, index) => this.sides[index].color.set(colour));
    for (const panel of this.panels) panel.material.color.set(this.colours.panel);
    this.ambient.intensity = dark ? 1.7 : 2.1;
    this.beams.object.material.opacity = dark ? 0.55 : 0.5;
    this.obstacleKey = this.shadeKey = "";
    for (const one of this.users.values()) this.scene.remove(one.group);
    this.users.clear();
  }

  // The room: only the sides that face away from the camera are drawn. They hide nothing: a tilted mirror
  // passes through the plane of its wall.
  shell() {
    const [x, y, z] = this.plan.size_m;
    // Sides of the box in the order +x, -x, +y, -y, +z, -z.
    this.sides = Array.from({ length: 6 }, () => new THREE.MeshBasicMaterial({ side: THREE.BackSide, depthWrite: false }));
    this.box = new THREE.Mesh(new THREE.BoxGeometry(x, y, z).translate(0, 0, z / 2), this.sides);
    this.box.renderOrder = -2;
    this.scene.add(this.box);
    this.sun.position.set(0.3 * x, -0.5 * y, 2 * z);
  }

  array() {
    const margin = 0.35;
    this.panels = wallsOf(this.plan).map(({ centre, inward, along, up }) => {
      const panel = new THREE.Mesh(new THREE.PlaneGeometry(along + margin, up + margin), new THREE.MeshBasicMaterial({ depthWrite: false }));
      panel.renderOrder = -1;
      panel.up.set(0, 0, 1);
      panel.position.set(centre[0] - 0.012 * inward[0], centre[1] - 0.012 * inward[1], centre[2]);
      panel.lookAt(centre[0] + inward[0], centre[1] + inward[1], centre[2]);
      return panel;
    });
    const count = this.plan.mirrors_m.length;
    this.mirrors = new THREE.InstancedMesh(new THREE.PlaneGeometry(1, 1), new THREE.MeshBasicMaterial({ side: THREE.DoubleSide }), count);
    this.mirrors.frustumCulled = false;
    this.plan.mirrors_m.forEach((_, index) => this.mirrors.setColorAt(index, new THREE.Color(UNUSED)));
    this.scene.add(...this.panels, this.mirrors);
  }

  leds() {
    for (const [x, y, z] of this.plan.leds_m) {
      const lamp = new THREE.Mesh(new THREE.CylinderGeometry(0.16, 0.16, 0.05, 24).rotateX(Math.PI / 2), new THREE.MeshBasicMaterial({ color: LIGHT }));
      lamp.position.set(x, y, z - 0.03);
      const glow = new THREE.Sprite(new THREE.SpriteMaterial({ map: glowTexture(), transparent: true, depthWrite: false }));
      glow.scale.setScalar(0.9);
      glow.position.set(x, y, z - 0.05);
      this.scene.add(lamp, glow);
    }
  }

  heatPlane() {
    const [x, y] = this.plan.size_m;
    const plane = new THREE.Mesh(new THREE.PlaneGeometry(x, y).translate(0, 0, 0.012), new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.85, depthWrite: false }));
    plane.visible = false;
    return plane;
  }

  // Shows a heat map, or none.
  setHeat(map) {
    this.heat.visible = map !== null;
    if (!map) return;
    this.heat.material.map?.dispose();
    this.heat.material.map = heatTexture(map);
    this.heat.material.needsUpdate = true;
  }

  // Moves everything to a frame. `shown` says what the switches show.
  place(frame, paths, shown) {
    this.placeMirrors(frame, shown.wall);
    this.placeUsers(frame, shown);
    this.placeObstacles(frame);
    this.placeShades(frame, shown);
    this.placeLight(frame, shown);
    this.placePaths(frame, shown.paths ? paths : new Map());
  }

  // Keeps the users' names apart, as a camera sees them.
  separateLabels(camera) {
    separateSprites([...this.users.values()].map(({ label }) => label), camera);
  }

  placeMirrors(frame, isShown) {
    this.mirrors.visible = isShown;
    for (const panel of this.panels) panel.visible = isShown;
    if (!isShown || frame.mirrors_m.length !== this.mirrors.count) return;
    const unusable = new Set(frame.unusable);
    const [matrix, colour] = [new THREE.Matrix4(), new THREE.Color()];
    frame.mirrors_m.forEach((flat, index) => {
      const [a, b, c, d] = cornersOf(flat);
      const width = new THREE.Vector3(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
      const height = new THREE.Vector3(d[0] - a[0], d[1] - a[1], d[2] - a[2]);
      matrix.makeBasis(width, height, width.clone().cross(height).normalize());
      matrix.setPosition((a[0] + c[0]) / 2, (a[1] + c[1]) / 2, (a[2] + c[2]) / 2);
      this.mirrors.setMatrixAt(index, matrix);
      this.mirrors.setColorAt(index, colour.set(mirrorColour(frame, index, unusable)));
    });
    this.mirrors.instanceMatrix.needsUpdate = true;
    this.mirrors.instanceColor.needsUpdate = true;
  }

  placeUsers(frame, shown) {
    const present = new Set(frame.users.map(({ user }) => user));
    this.headings.begin();
    for (const [user, { group }] of this.users) {
      if (!present.has(user)) {
        this.scene.remove(group);
        this.users.delete(user);
      }
    }
    for (const user of frame.users) {
      let one = this.users.get(user.user);
      if (!one) this.users.set(user.user, (one = this.figure(user)));
      const lost = !shown.wall && user.without_mirrors_mbps < user.min_rate_mbps;
      one.detector.position.set(...user.at_m);
      one.label.place(user.at_m, lost ? `${user.user} ✕` : String(user.user));
      one.body.visible = user.body_m !== null;
      if (user.body_m) {
        const [x, y, radius, height] = user.body_m;
        one.body.position.set(x, y, height / 2);
        one.body.scale.set(radius, radius, height);
      }
      one.belief.visible = shown.belief && Boolean(user.belief);
      if (!one.belief.visible) continue;
      ellipse(one.belief, user.belief);
      const [from, to] = headingMark(user.belief);
      this.headings.add([...from, BELIEF_Z_M], [...to, BELIEF_Z_M], userColour(user.user));
    }
    this.headings.end();
  }

  figure({ user }) {
    const colour = new THREE.Color(userColour(user));
    const group = new THREE.Group();
    const body = new THREE.Mesh(
      new THREE.CylinderGeometry(1, 1, 1, 28).rotateX(Math.PI / 2),
      new THREE.MeshLambertMaterial({ color: colour, transparent: true, opacity: BODY_OPACITY, depthWrite: false }),
    );
    const detector = new THREE.Mesh(new THREE.SphereGeometry(0.075, 20, 14), new THREE.MeshLambertMaterial({ color: colour }));
    const label = new Label(userColour(user));
    const belief = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: colour }));
    group.add(body, detector, label.sprite, belief);
    this.scene.add(group);
    return { group, body, detector, label, belief };
  }

  placeObstacles(frame) {
    const key = JSON.stringify(frame.obstacles_m);
    if (key === this.obstacleKey) return;
    this.obstacleKey = key;
    this.obstacles.children.forEach((one) => one.geometry.dispose());
    this.obstacles.clear();
    for (const [x, y, radius, height] of frame.obstacles_m) {
      const shape = new THREE.CylinderGeometry(radius, radius, height, 32).rotateX(Math.PI / 2).translate(x, y, height / 2);
      this.obstacles.add(new THREE.Mesh(shape, new THREE.MeshLambertMaterial({ color: this.colours.obstacle, transparent: true, opacity: 0.8 })));
    }
  }

  // Areas without direct light, drawn on the floor, where they hide nothing.
  placeShades(frame, shown) {
    this.shades.visible = !shown.heat;
    const key = JSON.stringify(frame.blocked_areas_m);
    if (key === this.shadeKey) return;
    this.shadeKey = key;
    this.shades.children.forEach((one) => one.geometry.dispose());
    this.shades.clear();
    const material = new THREE.MeshBasicMaterial({
      color: this.colours.shade, transparent: true, opacity: 0.2, depthWrite: false, side: THREE.DoubleSide,
    });
    for (const corners of frame.blocked_areas_m) this.shades.add(new THREE.Mesh(fan(corners, 0.008), material));
  }

  placeLight(frame, shown) {
    this.direct.begin();
    this.dashed.begin();
    this.beams.begin();
    for (const user of frame.users) {
      const led = this.plan.leds_m[user.led];
      if (!led) continue;
      // A path that no process reports is not drawn.
      if (user.blocked === true) this.dashed.add(led, user.at_m, this.colours.blocked);
      else if (user.blocked === false) this.direct.add(led, user.at_m, LIGHT);
    }
    if (shown.beams && shown.wall) {
      frame.serves.forEach((index, mirror) => {
        const user = frame.users[index];
        if (!user) return;
        this.beams.add(this.plan.mirrors_m[mirror], user.at_m, userColour(user.user));
      });
    }
    for (const lines of [this.direct, this.dashed, this.beams]) lines.end();
  }

  placePaths(frame, paths) {
    this.paths.begin();
    for (const [user, points] of paths) {
      for (let at = 1; at < points.length; at++) {
        this.paths.add([points[at - 1][1], points[at - 1][2], 0.02], [points[at][1], points[at][2], 0.02], userColour(user));
      }
    }
    this.paths.end();
  }
}

function glowTexture() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const brush = canvas.getContext("2d");
  const glow = brush.createRadialGradient(32, 32, 2, 32, 32, 32);
  glow.addColorStop(0, "rgba(255, 208, 60, 0.9)");
  glow.addColorStop(0.4, "rgba(255, 200, 40, 0.28)");
  glow.addColorStop(1, "rgba(255, 200, 40, 0)");
  brush.fillStyle = glow;
  brush.fillRect(0, 0, 64, 64);
  return new THREE.CanvasTexture(canvas);
}
