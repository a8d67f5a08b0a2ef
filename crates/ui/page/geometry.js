// What the drawings of the room in 3-D and in 2-D share: the static geometry and the colours.

// Colours that are distinguishable with colour-vision deficiency, then as many as a room may have users.
const BASIC = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#999933", "#aa4499"];
const USERS_MAX = 64;
// Hues a golden angle apart, whose neighbours differ in saturation or lightness; as #rrggbb.
function generated(index) {
  const [hue, saturation, lightness] = [(index * 137.508) % 360, [0.75, 0.45][index % 2], [0.38, 0.52, 0.66][index % 3]];
  const chroma = saturation * Math.min(lightness, 1 - lightness);
  const channel = (offset) => {
    const part = (offset + hue / 30) % 12;
    return Math.round(255 * (lightness - chroma * Math.max(-1, Math.min(part - 3, 9 - part, 1))));
  };
  return `#${[0, 8, 4].map((offset) => channel(offset).toString(16).padStart(2, "0")).join("")}`;
}
export const USER_COLOURS = Array.from({ length: USERS_MAX }, (_, index) => BASIC[index] ?? generated(index));

// The colour of each present user, as an index.
const taken = new Map();

// Takes the ids of the users who are present: frees the colours of the others.
export function presentUsers(ids) {
  const present = new Set(ids);
  for (const user of taken.keys()) if (!present.has(user)) taken.delete(user);
  for (const user of present) userColour(user);
}

// No two present users share a colour, and a user keeps its colour while others come and go.
export function userColour(user) {
  if (!taken.has(user)) {
    const used = new Set(taken.values());
    const preferred = user % BASIC.length;
    const free = used.has(preferred) ? USER_COLOURS.findIndex((_, index) => !used.has(index)) : preferred;
    taken.set(user, free < 0 ? user % USERS_MAX : free);
  }
  return USER_COLOURS[taken.get(user)];
}

export const UNUSED = "#a4adb6";
export const UNUSABLE = "#882255";
export const LIGHT = "#f0b800";

export function palette(dark) {
  return dark
    ? { back: "#14191f", floor: "#333d47", wall: "#222a33", side: "#1d242c", edge: "#5d6974", ink: "#e9ecef", obstacle: "#7d8893", shade: "#000000", panel: "#11161b", blocked: "#a0aab5" }
    : { back: "#ffffff", floor: "#dbe1e6", wall: "#edf1f4", side: "#e3e8ed", edge: "#a9b3bd", ink: "#1a1e23", obstacle: "#8a949e", shade: "#20262c", panel: "#ffffff", blocked: "#59626d" };
}

// The first array of mirrors, from which the camera looks away.
const wallOf = (plan) => wallsOf(plan)[0];

// Each array of mirrors: centre, unit vector into the room, extents along the wall and up.
export function wallsOf(plan) {
  let first = 0;
  return plan.arrays.map((count) => wall(plan, plan.mirrors_m.slice(first, (first += count))));
}

function wall(plan, mirrors) {
  const [x, y, z] = [0, 1, 2].map((axis) => {
    const values = mirrors.map((mirror) => mirror[axis]);
    return { low: Math.min(...values), high: Math.max(...values) };
  });
  if (!mirrors.length) return { centre: [0, plan.size_m[1] / 2, plan.size_m[2] / 2], inward: [0, -1], along: 0, up: 0 };
  const middle = ({ low, high }) => (low + high) / 2;
  const centre = [middle(x), middle(y), middle(z)];
  const isAlongX = x.high - x.low >= y.high - y.low;
  const inward = isAlongX ? [0, -Math.sign(centre[1]) || -1] : [-Math.sign(centre[0]) || -1, 0];
  return { centre, inward, along: isAlongX ? x.high - x.low : y.high - y.low, up: z.high - z.low };
}

// The bounds of the room and the named views, as the camera needs them.
export function boundsOf(plan) {
  const [x, y, z] = plan.size_m;
  const corners = [-0.5, 0.5].flatMap((sx) => [-0.5, 0.5].flatMap((sy) => [0, z].map((height) => [sx * x, sy * y, height])));
  const largest = Math.max(x, y, z);
  const opposite = Math.atan2(wallOf(plan).inward[1], wallOf(plan).inward[0]);
  return {
    corners,
    distance: { min: 0.3 * largest, max: 8 * largest },
    views: {
      wall: { azimuth: opposite + 0.2, elevation: 0.3 },
      corner: { azimuth: opposite + 0.8, elevation: 0.5 },
      top: { azimuth: opposite, elevation: 1.52 },
    },
  };
}

// The corners of mirror `index` in a frame, as four points.
export const cornersOf = (corners) => [0, 3, 6, 9].map((at) => corners.slice(at, at + 3));

// The colour of a mirror: that of the user whom it serves.
export function mirrorColour(frame, index, unusable) {
  if (unusable.has(index)) return UNUSABLE;
  const user = frame.users[frame.serves[index]];
  return user ? userColour(user.user) : UNUSED;
}

// Ends of the mark of a believed heading: a certain one is half a metre long.
export function headingMark({ at_m, heading }) {
  return [at_m, [at_m[0] + 0.5 * heading[0], at_m[1] + 0.5 * heading[1]]];
}
