// How long each user was below the minimum rate in the last minute.
const SPAN_S = 60;

export class Outages {
  constructor() {
    this.users = new Map();
  }

  // Takes the rates at a time of the room; a user who has left is forgotten.
  take(now) {
    const present = new Map();
    for (const user of now.users.filter((user) => user.is_rate_known)) {
      const past = this.users.get(user.user) ?? [];
      const last = past.at(-1);
      // A restarted room begins again; events of one time count once.
      if (last && now.time_s < last.time_s) past.length = 0;
      if (!last || now.time_s !== last.time_s) past.push({ time_s: now.time_s, below: user.rate_mbps < user.min_rate_mbps });
      while (past[0].time_s < now.time_s - SPAN_S) past.shift();
      present.set(user.user, past);
    }
    this.users = present;
  }

  // Share of the time below the minimum rate, and the longest outage in s; null while unknown. A rate
  // holds until the next one.
  of(user) {
    const past = this.users.get(user);
    if (!past || past.length < 2) return null;
    let [below_s, longest_s, since_s] = [0, 0, null];
    for (let index = 1; index < past.length; index += 1) {
      const [before, after] = [past[index - 1], past[index]];
      if (!before.below) { since_s = null; continue; }
      since_s ??= before.time_s;
      below_s += after.time_s - before.time_s;
      longest_s = Math.max(longest_s, after.time_s - since_s);
    }
    return { share: below_s / (past.at(-1).time_s - past[0].time_s), longest_s };
  }
}
