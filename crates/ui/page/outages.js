// How long each user was below the minimum rate in the last minute, or since the page observes the user.
const SPAN_S = 60;

export class Outages {
  constructor() {
    this.users = new Map();
    this.wasSilent = false;
  }

  // Takes the rates at a time of the room; a user who has left is forgotten.
  take(now) {
    // The figures of a silent room stay, and those of the next report begin again: the time between is unknown.
    if (now.origin === "no-data") {
      this.wasSilent = true;
      return;
    }
    if (this.wasSilent) this.users.clear();
    this.wasSilent = false;
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

  // The observed time in s, the share of it below the minimum rate, number of outages, and their p50, p95 and
  // longest length in s; null while unknown. A rate holds until the next one. The observed time cuts off the
  // first outage and the last.
  of(user) {
    const past = this.users.get(user);
    if (!past || past.length < 2) return null;
    const lengths_s = [];
    for (let index = 1; index < past.length; index += 1) {
      const [before, after] = [past[index - 1], past[index]];
      if (!before.below) continue;
      if (index === 1 || !past[index - 2].below) lengths_s.push(0);
      lengths_s[lengths_s.length - 1] += after.time_s - before.time_s;
    }
    const below_s = lengths_s.reduce((sum, length_s) => sum + length_s, 0);
    lengths_s.sort((one, other) => one - other);
    const [p50_s, p95_s, longest_s] = [0.5, 0.95, 1].map((share) => quantile(lengths_s, share));
    const observed_s = past.at(-1).time_s - past[0].time_s;
    return { observed_s, share: below_s / observed_s, count: lengths_s.length, p50_s, p95_s, longest_s };
  }
}

// The quantile of sorted values, linear between them, as in the tables of `heliostat-lab eval`; 0 without values.
function quantile(sorted, share) {
  if (sorted.length === 0) return 0;
  const place = share * (sorted.length - 1);
  const [below, above] = [sorted[Math.floor(place)], sorted[Math.ceil(place)]];
  return below + (place - Math.floor(place)) * (above - below);
}
