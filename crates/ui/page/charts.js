// The charts of sum rates over time and of decision times.
import { RedrawLimiter } from "./redraw.js";
import { capitalised } from "./sentence.js";

const SPAN_S = 90;
const KEEP_EVERY_S = 0.2;
// A longer time without figures is a gap in the lines.
const GAP_S = 2;
// A room starts within this time.
const START_S = 3;
// Distance of the names of earlier policies to the plot.
const EARLIER_GAP_PX = 4;
const FONT = "11px system-ui, sans-serif";
const SMALL_FONT = "9px system-ui, sans-serif";

// What the mirrors follow, by its name; that of a policy that no status has stated is empty.
const nameOf = ({ name }) => name || "policy unknown";

// One colour for each policy, the same in every report and figure.
const POLICY_COLOURS = {
  ddpg: "#0072b2", exhaustive: "#c08a00", analytic: "#56b4e9", "ddpg-raw": "#cc79a7", dql: "#d55e00",
  "q-learning": "#e69f00", sarsa: "#f0e442", greedy: "#117733", "fixed-point": "#44aa99", nearest: "#882255", random: "#999999",
  pso: "#aa4499", "sine-cosine": "#999933", hold: "#66a61e",
};

const TIPS = {
  no_irs: "No IRS: the sum rate of the same users at the same time without the mirrors (without an intelligent reflecting surface).",
  flat: "Flat: the sum rate with all mirrors flat against the wall.",
  oracle: "Oracle: the sum rate at the best angles that a search with the true positions finds. No controller knows these positions.",
  policy: "The sum rate with the mirrors as they are: under the policy in use, under a calibration, or parked, stopped or without a driver.",
};
const SHARE_TIP = "The figure in % is its share of the oracle's sum rate.";

// The points, and in each gap those that `within` gives for its two ends.
function inGaps(points, within) {
  return points.flatMap((point, index) => {
    const before = points[index - 1];
    return before && isGap(before, point) ? [...within(before, point), point] : [point];
  });
}

const isGap = (before, point) => point.time_s - before.time_s > GAP_S;

// The points with an empty one in each gap, so that no line crosses a time without figures.
const withGaps = (points) => inGaps(points, (before, point) => [{ time_s: (before.time_s + point.time_s) / 2 }]);

// The points with those of the server in each gap: the page was loading, asleep or without a connection then.
export const filled = (points, kept) =>
  inGaps(points, (before, point) => kept.filter(({ time_s }) => time_s > before.time_s && time_s < point.time_s));

// The points in the `history` of the server.
const pointsOf = (history) => history.map(([time_s, sample]) => ({ time_s, ...sample }));

// The stretches of a line in which the mirrors followed the same, each as what it is drawn from: its beginning in s
// before now, negative, and its name and whether the policy was idle.
export function stretches(points, now_s) {
  const begins = points.filter(({ name }, index) => name !== points[index - 1]?.name);
  return begins.map(({ time_s, name, idle }) => ({ from_s: time_s - now_s, name, idle }));
}

// The points without those at the beginning at which no policy was followed yet: a room starts parked, and its first
// messages arrive one after the other. Where this lasts, all points stay.
export function settled(points) {
  const first = points.findIndex(({ name, idle }) => name && !idle);
  return first > 0 && points[first].time_s - points[0].time_s < START_S ? points.slice(first) : points;
}

// The background of a mark in the legend: the colour of a line, with the dashes of that line.
export function markOf(colour, [on, off]) {
  return on ? `repeating-linear-gradient(90deg, ${colour} 0 ${on}px, transparent ${on}px ${on + off}px)` : colour;
}

export class Charts {
  // `askHistory` gets the history that the server has by then.
  constructor(plan, askHistory) {
    this.askHistory = askHistory;
    this.budget = plan.budget_us;
    this.sum = document.getElementById("sum-chart");
    this.latency = document.getElementById("latency-chart");
    this.sumPlot = this.latencyPlot = null;
    this.past = pointsOf(plan.history);
    this.followed = { name: "", idle: true };
    this.stretches = [];
    // The legend of the line's earlier colours, above the lines of the chart, which keeps its size.
    this.earlier = Object.assign(document.createElement("p"), { className: "earlier", hidden: true });
    this.sum.append(this.earlier);
    // What an empty chart says.
    const empty = (chart, text) => chart.appendChild(Object.assign(document.createElement("p"), { className: "empty", textContent: text, hidden: true }));
    this.noSums = empty(this.sum, `no sum rates in the last ${SPAN_S} s`);
    this.noDecisions = empty(this.latency, "no decisions in the last 30 s");
    this.redraw = new RedrawLimiter(500);
    const observer = new ResizeObserver(() => {
      this.redraw.reset();
      // Figures that are stale bring no redraw.
      this.fit(this.sumPlot, this.sum);
      this.fit(this.latencyPlot, this.latency);
    });
    for (const chart of [this.sum, this.latency]) observer.observe(chart);
  }

  // The colours of the style sheet.
  theme() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    [this.ink, this.card, this.grid, this.muted] = ["text", "card", "line", "muted"].map(colour);
    [this.flat, this.idle, this.unknown] = ["flat", "idle", "unknown"].map(colour);
    this.redraw.reset();
  }

  // `followed` is what the mirrors follow: its name, and why it is not the policy.
  update(now, followed) {
    this.followed = { name: followed.name, idle: followed.idle !== "" };
    if (now.sum_mbps) {
      const newest = this.past.at(-1);
      if (!newest || now.time_s - newest.time_s >= KEEP_EVERY_S) this.past.push({ time_s: now.time_s, ...this.followed, ...now.sum_mbps });
      if (newest && isGap(newest, now)) this.fillGaps();
      this.past = settled(this.past.filter((point) => now.time_s - point.time_s <= SPAN_S));
    }
    this.redraw.run(() => {
      this.drawSum(now.time_s);
      this.drawLatency(now.latency);
    });
  }

  // Without an answer the gaps stay.
  async fillGaps() {
    try {
      const kept = pointsOf(await this.askHistory());
      this.past = filled(this.past, kept);
    } catch (error) {
      console.info(error);
    }
  }

  // A reference that the mirrors follow as their policy is named apart from its line.
  lines() {
    const reference = (policy, name) => (this.followed.name === policy ? `${name} (reference)` : name);
    return [
      ["policy", nameOf(this.followed), this.colourOf(this.followed), [], 2.5],
      ["no_irs", reference("no-irs", "no IRS"), "#bbbbbb", [], 1.5],
      ["flat", reference("flat", "flat"), this.flat, [2, 3], 1.5],
      ["oracle", reference("oracle", "oracle"), this.ink, [6, 4], 1.2],
    ];
  }

  // A policy has its colour, and one that is a reference that of its line. What the mirrors follow in place of one, and an unknown policy, have colours of their own.
  colourOf({ name, idle }) {
    if (idle) return this.idle;
    const references = { flat: this.flat, "no-irs": "#bbbbbb", oracle: this.ink };
    return name ? references[name] ?? POLICY_COLOURS[name] ?? "#0072b2" : this.unknown;
  }

  // The stroke of the line with the mirrors: each stretch has the colour of what the mirrors followed then.
  strokeOf({ ctx, bbox }) {
    if (this.stretches.length < 2) return this.colourOf(this.stretches[0] ?? this.followed);
    const stroke = ctx.createLinearGradient(bbox.left, 0, bbox.left + bbox.width, 0);
    this.stretches.forEach((stretch, index) => {
      const at = (from_s) => Math.min(1, Math.max(0, 1 + from_s / SPAN_S));
      stroke.addColorStop(at(stretch.from_s), this.colourOf(stretch));
      stroke.addColorStop(at(this.stretches[index + 1]?.from_s ?? 0), this.colourOf(stretch));
    });
    return stroke;
  }

  // The present sum rates, with their name.
  figures(sum, sumName) {
    const list = document.getElementById("sum-figures");
    const title = `${capitalised(sumName)} of all users, last 90 s, Mbit/s`;
    const heading = document.getElementById("sums-title");
    if (heading.textContent !== title) heading.textContent = title;
    this.lines().forEach(([key, name, colour, dash], index) => {
      if (!list.children[index]) list.insertAdjacentHTML("beforeend", "<div><dt></dt><dd><span></span> <small></small></dd></div>");
      const [term, figure] = list.children[index].children;
      const rate = sum?.[key];
      const share = rate != null && sum.oracle > 0 && key !== "oracle" ? `${((100 * rate) / sum.oracle).toFixed(0)} %` : "";
      term.style.setProperty("--swatch", markOf(colour, dash));
      if (!term.firstChild) {
        const explained = Object.assign(document.createElement("dfn"), { tabIndex: 0, title: key === "oracle" ? TIPS[key] : `${TIPS[key]} ${SHARE_TIP}` });
        term.append(explained);
      }
      if (term.firstChild.textContent !== name) term.firstChild.textContent = name;
      // A text that is replaced during a tap ends the tap.
      [rate == null ? "–" : rate.toFixed(1), share].forEach((text, index) => {
        if (figure.children[index].textContent !== text) figure.children[index].textContent = text;
      });
      figure.children[1].title = share && SHARE_TIP;
    });
  }

  // The names and colours of the line with the mirrors before the present ones, each with its end.
  showEarlier() {
    const earlier = new Map(this.stretches.map((stretch, index) => [
      nameOf(stretch), { colour: this.colourOf(stretch), end_s: -(this.stretches[index + 1]?.from_s ?? 0) },
    ]));
    earlier.delete(nameOf(this.followed));
    const before = this.earlier.offsetHeight;
    this.earlier.hidden = earlier.size === 0;
    this.earlier.replaceChildren(...[...earlier].map(([name, { colour, end_s }]) => {
      const mark = Object.assign(document.createElement("span"), { textContent: `${name} until ${end_s.toFixed(0)} s ago` });
      mark.style.setProperty("--swatch", colour);
      return mark;
    }));
    // The plot computes its padding again.
    if (this.earlier.offsetHeight !== before) this.sumPlot?.redraw(false, true);
  }

  // A plot in an element; `tip` gives the text for the index under the pointer.
  plot(element, options, data, tip) {
    const bubble = Object.assign(document.createElement("output"), { className: "tip", hidden: true });
    const plot = new uPlot({
      width: element.clientWidth, height: element.clientHeight, padding: [4, 6, 0, 0],
      legend: { show: false }, cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
      ...options,
      hooks: {
        ...options.hooks,
        setCursor: [(self) => {
          const { idx, left } = self.cursor;
          bubble.hidden = idx == null || left < 0;
          if (bubble.hidden) return;
          bubble.textContent = tip(idx);
          bubble.style.left = `${Math.max(0, Math.min(left + 44, element.clientWidth - bubble.offsetWidth))}px`;
        }],
      },
    }, data, element);
    element.append(bubble);
    return plot;
  }

  fit(plot, element) {
    if (plot && (plot.width !== element.clientWidth || plot.height !== element.clientHeight)) {
      plot.setSize({ width: element.clientWidth, height: element.clientHeight });
    }
  }

  show(plot, element, data) {
    this.fit(plot, element);
    plot.setData(data);
  }

  axis(label, extra) {
    return {
      stroke: () => this.muted, font: FONT, label, labelFont: FONT, labelSize: label ? 13 : 0, labelGap: 0, size: 18, gap: 2,
      grid: { stroke: () => this.grid, width: 1 }, ticks: { stroke: () => this.grid, width: 1, size: 3 }, ...extra,
    };
  }

  // The vertical axis starts at 0.
  fromZero() {
    return { range: (_, __, most) => [0, most > 0 ? 1.05 * most : 1] };
  }

  drawSum(now_s) {
    const lines = this.lines().reverse();
    const points = withGaps(this.past);
    this.stretches = stretches(this.past, now_s);
    this.showEarlier();
    this.noSums.hidden = this.past.some(({ time_s }) => now_s - time_s <= SPAN_S);
    const data = [points.map((point) => point.time_s - now_s), ...lines.map(([key]) => points.map((point) => point[key] ?? null))];
    if (this.sumPlot) return this.show(this.sumPlot, this.sum, data);
    const text = (index) => {
      const [x, ...rates] = this.sumPlot.data.map((values) => values[index]);
      const then = this.stretches.findLast(({ from_s }) => from_s <= x) ?? this.followed;
      const lineName = (key, name) => (key === "policy" ? nameOf(then) : name);
      const named = this.lines().reverse().map(([key, name], line) => (rates[line] == null ? "" : `${lineName(key, name)} ${rates[line].toFixed(1)}`));
      const shown = named.filter(Boolean).reverse();
      return [`${(-x).toFixed(0)} s ago`, ...(shown.length ? shown : ["no figures"])].join(" · ");
    };
    this.sumPlot = this.plot(this.sum, {
      padding: [() => this.earlier.offsetHeight + EARLIER_GAP_PX, 14, 0, 0],
      scales: { x: { time: false, range: [-SPAN_S, 0] }, y: this.fromZero() },
      series: [{}, ...lines.map(([key, , , dash, width], line) => ({
        stroke: (plot) => (key === "policy" ? this.strokeOf(plot) : this.lines()[lines.length - 1 - line][2]), dash, width, points: { show: false },
      }))],
      axes: [this.axis("", { values: (_, splits) => splits.map((x) => (x === 0 ? "now" : `${-x} s`)) }), this.axis("", { size: 34, space: 16 })],
    }, data, text);
  }

  // There are no buckets before the first report of a controller.
  drawLatency({ edges_us, counts }) {
    const total = counts.reduce((sum, count) => sum + count, 0);
    const within = edges_us.filter((edge) => edge <= this.budget).length;
    this.noDecisions.hidden = total > 0;
    this.edges = edges_us;
    const shares = counts.map((count) => (total ? (100 * count) / total : 0));
    const data = [
      counts.map((_, index) => index),
      shares.map((share, index) => (index < within ? share : null)),
      shares.map((share, index) => (index < within ? null : share)),
    ];
    if (this.latencyPlot) return this.show(this.latencyPlot, this.latency, data);
    const short = (edge) => (edge % 1000 ? String(edge) : `${edge / 1000}k`);
    const bars = uPlot.paths.bars({ size: [0.92, Infinity] });
    const series = (colour) => ({ stroke: colour, fill: colour, width: 0, paths: bars, points: { show: false } });
    const text = (index) => {
      const [, ...halves] = this.latencyPlot.data;
      const bucket = index < this.edges.length ? `up to ${this.edges[index]} µs` : `over ${this.edges.at(-1)} µs`;
      return `${bucket}: ${(halves[0][index] ?? halves[1][index] ?? 0).toFixed(2)} %`;
    };
    this.latencyPlot = this.plot(this.latency, {
      scales: { x: { time: false, range: () => [-0.5, this.edges.length + 0.5] }, y: this.fromZero() },
      series: [{}, series("#56b4e9"), series("#d55e00")],
      axes: [
        // The edges lie between the buckets.
        this.axis("", {
          splits: () => this.edges.map((_, index) => index + 0.5), values: () => this.edges.map(short), font: SMALL_FONT, grid: { show: false },
        }),
        this.axis("%", { size: 26, space: 16 }),
      ],
      hooks: { draw: [(plot) => this.drawLimit(plot)] },
    }, data, text);
  }

  // The time limit lies between two buckets.
  drawLimit(plot) {
    const { ctx, bbox } = plot;
    const within = this.edges.filter((edge) => edge <= this.budget).length;
    if (within === 0) return;
    const x = Math.round(plot.valToPos(within - 0.5, "x", true));
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = this.ink;
    ctx.lineWidth = 2 * uPlot.pxRatio;
    ctx.font = `${11 * uPlot.pxRatio}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    // Legible before the bars too.
    const limit = `${this.budget / 1000} ms`;
    ctx.fillStyle = `${this.card}cc`;
    ctx.fillRect(x + 2 * uPlot.pxRatio, bbox.top, ctx.measureText(limit).width + 4 * uPlot.pxRatio, 13 * uPlot.pxRatio);
    ctx.fillStyle = this.ink;
    ctx.fillText(limit, x + 4 * uPlot.pxRatio, bbox.top);
    ctx.restore();
  }
}
