// Shapes for three.js whose contents change from frame to frame.
import * as THREE from "./vendor/three.module.min.js";
import { heatPixels } from "./heat.js";

// Height of a drawn belief above the floor.
export const BELIEF_Z_M = 0.03;
const UP = new THREE.Vector3(0, 0, 1);

// Coloured line segments, one pixel wide, in one buffer, which grows and is reused.
export class Lines {
  constructor({ opacity, dash = 0 }) {
    const material = dash
      ? new THREE.LineDashedMaterial({ vertexColors: true, transparent: true, opacity, dashSize: dash, gapSize: dash })
      : new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, opacity });
    this.isDashed = dash > 0;
    this.object = new THREE.LineSegments(new THREE.BufferGeometry(), material);
    this.object.frustumCulled = false;
    this.colour = new THREE.Color();
    this.reserve(64);
  }

  reserve(segments) {
    this.capacity = segments;
    this.object.geometry.dispose();
    this.object.geometry = new THREE.BufferGeometry();
    this.points = new Float32Array(6 * segments);
    this.colours = new Float32Array(6 * segments);
    this.object.geometry.setAttribute("position", new THREE.BufferAttribute(this.points, 3));
    this.object.geometry.setAttribute("color", new THREE.BufferAttribute(this.colours, 3));
  }

  begin() {
    this.count = 0;
  }

  add(from, to, colour) {
    if (this.count >= this.capacity) {
      const [points, colours] = [this.points, this.colours];
      this.reserve(2 * this.capacity);
      this.points.set(points);
      this.colours.set(colours);
    }
    this.colour.set(colour);
    const at = 6 * this.count++;
    this.points.set(from, at);
    this.points.set(to, at + 3);
    this.colour.toArray(this.colours, at);
    this.colour.toArray(this.colours, at + 3);
  }

  end() {
    const { geometry } = this.object;
    geometry.setDrawRange(0, 2 * this.count);
    geometry.attributes.position.needsUpdate = true;
    geometry.attributes.color.needsUpdate = true;
    if (this.isDashed) this.object.computeLineDistances();
  }
}

// Coloured segments with a thickness in m: instances of one cylinder.
export class Tubes {
  constructor({ radius, opacity = 1 }) {
    this.object = new THREE.Group();
    this.radius = radius;
    this.material = new THREE.MeshBasicMaterial({ transparent: opacity < 1, opacity });
    // From the origin to (0, 0, 1).
    this.shape = new THREE.CylinderGeometry(1, 1, 1, 8, 1, true).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    [this.colour, this.matrix, this.towards, this.at] = [new THREE.Color(), new THREE.Matrix4(), new THREE.Vector3(), new THREE.Vector3()];
    this.turn = new THREE.Quaternion();
    this.size = new THREE.Vector3();
    this.reserve(16);
  }

  reserve(segments) {
    const old = this.mesh;
    this.mesh = new THREE.InstancedMesh(this.shape, this.material, segments);
    this.mesh.frustumCulled = false;
    this.mesh.instanceColor = new THREE.InstancedBufferAttribute(new Float32Array(3 * segments), 3);
    if (old) {
      this.mesh.instanceMatrix.array.set(old.instanceMatrix.array);
      this.mesh.instanceColor.array.set(old.instanceColor.array);
      this.object.remove(old);
      old.dispose();
    }
    this.capacity = segments;
    this.object.add(this.mesh);
  }

  begin() {
    this.count = 0;
  }

  add(from, to, colour) {
    if (this.count >= this.capacity) this.reserve(2 * this.capacity);
    this.at.set(...from);
    this.towards.set(...to).sub(this.at);
    const length = this.towards.length();
    if (length < 1e-6) return;
    this.turn.setFromUnitVectors(UP, this.towards.divideScalar(length));
    this.matrix.compose(this.at, this.turn, this.size.set(this.radius, this.radius, length));
    this.mesh.setMatrixAt(this.count, this.matrix);
    this.mesh.setColorAt(this.count++, this.colour.set(colour));
  }

  end() {
    this.mesh.count = this.count;
    this.mesh.instanceMatrix.needsUpdate = true;
    this.mesh.instanceColor.needsUpdate = true;
  }
}

// A convex polygon in a horizontal plane.
export function fan(corners, height) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners.flatMap(([x, y]) => [x, y, height]), 3));
  geometry.setIndex(corners.slice(2).flatMap((_, index) => [0, index + 1, index + 2]));
  return geometry;
}

// Sets a loop to the ellipse of a belief: centre, two semi-axes in m and the angle of the first.
export function ellipse(loop, { at_m, semi_axes_m, angle_rad }) {
  const points = Array.from({ length: 48 }, (_, index) => {
    const [along, across] = [semi_axes_m[0] * Math.cos((index * Math.PI) / 24), semi_axes_m[1] * Math.sin((index * Math.PI) / 24)];
    const [cos, sin] = [Math.cos(angle_rad), Math.sin(angle_rad)];
    return new THREE.Vector3(at_m[0] + along * cos - across * sin, at_m[1] + along * sin + across * cos, BELIEF_Z_M);
  });
  loop.geometry.setFromPoints(points);
}

// A texture of a heat map; row 0 of the map is at the smallest y.
export function heatTexture(map) {
  const texture = new THREE.DataTexture(heatPixels(map), map.columns, map.rows);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.magFilter = texture.minFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  return texture;
}
