// The names of the users in the 3-D picture.
import * as THREE from "./vendor/three.module.min.js";

// Height of a label's frame as a share of the sprite, and how often the shifts are corrected.
const FRAME_HEIGHT = 0.92;
const ROUNDS = 8;

// A text that faces the camera and has the same size at every distance.
export class Label {
  constructor(colour) {
    this.colour = colour;
    this.canvas = document.createElement("canvas");
    [this.canvas.width, this.canvas.height] = [96, 48];
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    this.sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: this.texture, depthTest: false, transparent: true, sizeAttenuation: false }));
    this.sprite.scale.set(0.05, 0.025, 1);
    this.sprite.renderOrder = 2;
    this.text = null;
    // Width of the text's frame as a share of the sprite.
    this.width = 0;
  }

  place([x, y, z], text) {
    this.sprite.position.set(x, y, z + 0.24);
    if (text === this.text) return;
    this.text = text;
    const brush = this.canvas.getContext("2d");
    brush.clearRect(0, 0, 96, 48);
    brush.font = "bold 30px system-ui, sans-serif";
    brush.textAlign = "center";
    brush.textBaseline = "middle";
    const width = Math.max(40, brush.measureText(text).width + 22);
    this.width = (width + 2) / 96;
    brush.fillStyle = this.colour;
    brush.beginPath();
    brush.roundRect(48 - width / 2, 4, width, 40, 20);
    brush.fill();
    brush.lineWidth = 2;
    brush.strokeStyle = "#ffffff";
    brush.stroke();
    brush.fillStyle = inkOn(this.colour);
    brush.fillText(text, 48, 25);
    this.texture.needsUpdate = true;
  }
}

// Black or white, whichever is easier to read on a colour.
function inkOn(colour) {
  const [red, green, blue] = [1, 3, 5].map((at) => (parseInt(colour.slice(at, at + 2), 16) / 255) ** 2.2);
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.25 ? "#111111" : "#ffffff";
}

// Shifts to the side, in widths of a sprite, so that no label covers another one. A label has the place [x, y] of its
// centre, in widths and heights of a sprite, and the width of its frame.
function separate(labels) {
  const shifts = labels.map(() => 0);
  const byX = labels.map((_, index) => index).sort((a, b) => labels[a].at[0] - labels[b].at[0]);
  for (let round = 0; round < ROUNDS; round++) {
    byX.forEach((left, order) => {
      for (const right of byX.slice(order + 1)) {
        const [one, other] = [labels[left], labels[right]];
        const free = other.at[0] + shifts[right] - one.at[0] - shifts[left] - (one.width + other.width) / 2;
        if (free >= 0 || Math.abs(other.at[1] - one.at[1]) >= FRAME_HEIGHT) continue;
        shifts[left] += free / 2;
        shifts[right] -= free / 2;
      }
    });
  }
  return shifts;
}

// Shifts the labels as a camera sees them. Those behind the camera are not drawn, and shift no other one: their
// projection is mirrored into the picture.
export function separateSprites(labels, camera) {
  camera.updateMatrixWorld();
  const [across, , , , , up] = camera.projectionMatrix.elements;
  for (const { sprite } of labels) {
    sprite.visible = sprite.position.clone().applyMatrix4(camera.matrixWorldInverse).z < -camera.near;
  }
  const drawn = labels.filter(({ sprite }) => sprite.visible);
  const seen = drawn.map(({ sprite, width }) => {
    const { x, y } = sprite.position.clone().project(camera);
    return { at: [x / (across * sprite.scale.x), y / (up * sprite.scale.y)], width };
  });
  separate(seen).forEach((shift, index) => drawn[index].sprite.center.setX(0.5 - shift));
}
