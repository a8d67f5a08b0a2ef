// The colours of the heat map. The server computes its values.

// Viridis at equal steps: dark is a low rate.
const SCALE = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];

// Colour of a share between 0 and 1.
function heatColour(share) {
  const at = Math.min(1, Math.max(0, share)) * (SCALE.length - 1);
  const low = Math.min(SCALE.length - 2, Math.floor(at));
  return SCALE[low].map((value, channel) => Math.round(value + (at - low) * (SCALE[low + 1][channel] - value)));
}

// The map as RGBA bytes, row by row.
export function heatPixels(map) {
  const pixels = new Uint8Array(4 * map.columns * map.rows);
  map.rate_mbps.forEach((rate, index) => pixels.set([...heatColour(map.max_mbps > 0 ? rate / map.max_mbps : 0), 255], 4 * index));
  return pixels;
}

export const heatGradient = `linear-gradient(90deg, ${SCALE.map((colour) => `rgb(${colour})`).join(", ")})`;
