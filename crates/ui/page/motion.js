// Interpolates between the frames of the server, and keeps the path of each user.

// Limits of the duration of an interpolation, in ms.
const SHORTEST = 60;
const LONGEST = 500;
// A user who moves farther than this between two frames was placed there, in m.
const JUMP_M = 1.5;
const PATH_S = 15;
const PATH_EVERY_S = 0.15;

export class Motion {
  constructor() {
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.from = this.to = null;
    this.arrived = 0;
    this.duration = 200;
    // Path of each user by id: time in s, x and y in m.
    this.paths = new Map();
  }

  // Takes a frame that arrived at `now`, in ms.
  take(frame, now) {
    this.from = this.to ? this.at(now) : frame;
    if (this.to) {
      const passed = Math.min(LONGEST, Math.max(SHORTEST, now - this.arrived));
      this.duration += 0.3 * (passed - this.duration);
    }
    this.to = frame;
    this.arrived = now;
    this.keepPaths(frame, now / 1000);
  }

  // Whether the frame at `now` differs from the newest frame.
  isMoving(now) {
    return this.to !== null && !this.still.matches && now - this.arrived < this.duration;
  }

  // The frame at `now`. Users are matched by id, because they come and go.
  at(now) {
    const share = this.still.matches ? 1 : Math.min(1, (now - this.arrived) / this.duration);
    const { from, to } = this;
    if (!to || share >= 1 || from === to) return to;
    const before = new Map(from.users.map((user) => [user.user, user]));
    return {
      ...to,
      mirrors_m: from.mirrors_m.length === to.mirrors_m.length ? to.mirrors_m.map((corners, index) => mix(from.mirrors_m[index], corners, share)) : to.mirrors_m,
      users: to.users.map((user) => {
        const old = before.get(user.user);
        if (!old || Math.hypot(old.at_m[0] - user.at_m[0], old.at_m[1] - user.at_m[1]) > JUMP_M) return user;
        const body_m = user.body_m && old.body_m ? mix(old.body_m, user.body_m, share) : user.body_m;
        const belief = user.belief && old.belief ? { ...user.belief, at_m: mix(old.belief.at_m, user.belief.at_m, share) } : user.belief;
        return { ...user, at_m: mix(old.at_m, user.at_m, share), body_m, belief };
      }),
    };
  }

  keepPaths(frame, now_s) {
    const present = new Set();
    for (const { user, at_m } of frame.users) {
      present.add(user);
      const path = this.paths.get(user) ?? [];
      this.paths.set(user, path);
      const last = path.at(-1);
      if (!last || now_s - last[0] >= PATH_EVERY_S) path.push([now_s, at_m[0], at_m[1]]);
      if (last && Math.hypot(last[1] - at_m[0], last[2] - at_m[1]) > JUMP_M) path.splice(0, path.length - 1);
      while (path.length && now_s - path[0][0] > PATH_S) path.shift();
    }
    for (const user of this.paths.keys()) if (!present.has(user)) this.paths.delete(user);
  }
}

function mix(from, to, share) {
  return to.map((value, index) => from[index] + share * (value - from[index]));
}
