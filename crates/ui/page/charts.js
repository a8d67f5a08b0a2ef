// The charts of sum rates over time and of decision times.
import { RedrawLimiter } from "./redraw.js";

const SPAN_S = 90;
const KEEP_EVERY_S = 0.2;
const CONFIG = { displayModeBar: false, responsive: false };
const FONT = { family: "system-ui, sans-serif", size: 11 };

// One colour for each policy, the same in every report and figure.
const POLICY_COLOURS = {
  actor: "#0072b2", ddpg: "#0072b2", analytic: "#56b4e9", "ddpg-raw": "#cc79a7", dql: "#d55e00",
  "q-learning": "#e69f00", sarsa: "#f0e442", greedy: "#117733", "fixed-point": "#44aa99", nearest: "#882255", random: "#999999",
};

const TIPS = {
  no_irs: "No IRS: the sum rate of the same users at the same time without the mirrors (without an intelligent reflecting surface).",
  flat: "Flat: the sum rate with all mirrors flat against the wall.",
  oracle: "Oracle: the sum rate at the best angles that a search with the true positions finds. No controller knows these positions.",
  policy: "The sum rate with the mirrors as they are, under the policy in use.",
};

export class Charts {
  constructor(plan) {
    this.budget = plan.budget_us;
    this.sum = document.getElementById("sum-chart");
    this.latency = document.getElementById("latency-chart");
    this.past = plan.history.map(([time_s, sum]) => ({ time_s, ...sum }));
    this.policy = "";
    this.redraw = new RedrawLimiter(500);
    const observer = new ResizeObserver(() => this.redraw.reset());
    for (const chart of [this.sum, this.latency]) observer.observe(chart);
  }

  theme(dark) {
    this.ink = dark ? "#e9ecef" : "#1a1e23";
    this.grid = dark ? "#2e3740" : "#e2e6ea";
    this.muted = dark ? "#a0aab5" : "#59626d";
    this.flat = dark ? "#999999" : "#666666";
    this.redraw.reset();
  }

  update(now) {
    this.policy = now.policy || this.policy;
    if (now.sum_mbps && now.origin !== "no-data") {
      const newest = this.past.at(-1);
      if (!newest || now.time_s - newest.time_s >= KEEP_EVERY_S) this.past.push({ time_s: now.time_s, ...now.sum_mbps });
      this.past = this.past.filter((point) => now.time_s - point.time_s <= SPAN_S);
    }
    this.figures(now.sum_mbps);
    this.redraw.run(() => {
      this.drawSum(now.time_s);
      this.drawLatency(now.latency);
    });
  }

  lines() {
    return [
      ["policy", this.policy || "policy", POLICY_COLOURS[this.policy] ?? "#0072b2", "solid", 2.5],
      ["no_irs", "no IRS", "#bbbbbb", "solid", 1.5],
      ["flat", "flat", this.flat, "dot", 1.5],
      ["oracle", "oracle", this.ink, "dash", 1.2],
    ];
  }

  figures(sum) {
    const list = document.getElementById("sum-figures");
    this.lines().forEach(([key, name, colour], index) => {
      if (!list.children[index]) list.insertAdjacentHTML("beforeend", "<div><dt></dt><dd><span></span> <small></small></dd></div>");
      const [term, figure] = list.children[index].children;
      const rate = sum?.[key];
      const share = rate != null && sum.oracle > 0 && key !== "oracle" ? `${((100 * rate) / sum.oracle).toFixed(0)} %` : "";
      term.style.setProperty("--swatch", colour);
      if (!term.firstChild) {
        const explained = Object.assign(document.createElement("dfn"), { tabIndex: 0, title: TIPS[key] });
        term.append(explained);
      }
      if (term.firstChild.textContent !== name) term.firstChild.textContent = name;
      figure.children[0].textContent = rate == null ? "–" : rate.toFixed(1);
      figure.children[1].textContent = share;
    });
  }

  layout(chart, extra) {
    return {
      width: chart.clientWidth, height: chart.clientHeight,
      margin: { l: 34, r: 6, t: 4, b: 30 }, font: { ...FONT, color: this.muted }, showlegend: false,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", hovermode: "x unified",
      hoverlabel: { bgcolor: this.grid, font: { color: this.ink } }, uirevision: "kept", ...extra,
    };
  }

  axis(title, extra) {
    return { title: { text: title, standoff: 4 }, gridcolor: this.grid, zeroline: false, fixedrange: true, ...extra };
  }

  drawSum(now_s) {
    const x = this.past.map((point) => point.time_s - now_s);
    const traces = this.lines().reverse().map(([key, name, color, dash, width]) => ({
      type: "scatter", mode: "lines", name, x, y: this.past.map((point) => point[key]), line: { color, dash, width },
      hovertemplate: "%{y:.1f} Mbit/s",
    }));
    const layout = this.layout(this.sum, {
      xaxis: this.axis("s ago", { range: [-SPAN_S, 0] }),
      yaxis: this.axis("", { rangemode: "tozero" }),
    });
    Plotly.react(this.sum, traces, layout, CONFIG);
  }

  drawLatency({ edges_us, counts }) {
    const total = counts.reduce((sum, count) => sum + count, 0);
    const within = edges_us.filter((edge) => edge <= this.budget).length;
    const short = (edge) => (edge % 1000 ? String(edge) : `${edge / 1000}k`);
    const trace = {
      type: "bar", x: counts.map((_, index) => index), y: counts.map((count) => (total ? (100 * count) / total : 0)),
      marker: { color: counts.map((_, index) => (index < within ? "#56b4e9" : "#d55e00")) },
      customdata: counts.map((_, index) => (index < edges_us.length ? `up to ${edges_us[index]} us` : `over ${edges_us.at(-1)} us`)),
      hovertemplate: "%{customdata}: %{y:.2f} %<extra></extra>",
    };
    // The edges lie between the buckets, and so does the time limit.
    const line = within - 0.5;
    const layout = this.layout(this.latency, {
      bargap: 0.08, hovermode: "closest",
      xaxis: this.axis("us", {
        tickvals: edges_us.map((_, index) => index + 0.5), ticktext: edges_us.map(short), tickangle: 0, tickfont: { size: 9 },
        showgrid: false, range: [-0.5, Math.max(1, counts.length) - 0.5],
      }),
      yaxis: this.axis("%", { rangemode: "tozero" }),
      shapes: [{ type: "line", x0: line, x1: line, yref: "paper", y0: 0, y1: 1, line: { color: this.ink, width: 2 } }],
      annotations: [{
        x: line, yref: "paper", y: 1, xanchor: "left", yanchor: "top", showarrow: false, xshift: 4,
        text: `${this.budget / 1000} ms`, font: { color: this.ink },
      }],
    });
    Plotly.react(this.latency, [trace], layout, CONFIG);
  }
}
