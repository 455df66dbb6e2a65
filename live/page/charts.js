"use strict";
// Drawing: strip charts, orbit, Bode, tracked damping by BokehJS; the dial as SVG. Numbers only, no decisions.
const INK = { x: "#56b4e9", y: "#e69f00", theta3: "#2fc79b", theta4: "#d98fb8", drive: "#56b4e9", target: "#f2f2f2",
  marks: "#e69f00", limit: "#ff6b4a", grid: "#253240", soft: "#9fb0c0", model: "#f2f2f2", ground: "#18202a" };

const plotOf = (element, options) => {
  const figure = Bokeh.Plotting.figure({
    tools: "", toolbar_location: null, sizing_mode: "stretch_both", background_fill_color: "#121921",
    border_fill_color: INK.ground, outline_line_color: "#2b3846", min_border: 2, output_backend: "canvas",
    lod_threshold: null, ...options,
  });
  for (const axis of [figure.xaxis, figure.yaxis]) {
    axis.major_label_text_color = INK.soft; axis.axis_label_text_color = INK.soft;
    axis.major_label_text_font_size = "11px"; axis.axis_label_text_font_size = "11px";
    axis.axis_label_text_font_style = "normal"; axis.axis_line_color = "#2b3846";
    axis.major_tick_line_color = "#2b3846"; axis.minor_tick_line_color = null; axis.axis_label_standoff = 2;
  }
  for (const grid of [figure.xgrid, figure.ygrid]) grid.grid_line_color = INK.grid;
  element.inert = true; // keeps the keyboard's focus off the canvas, which does not use it; the panel has the description
  Bokeh.Plotting.show(figure, element);
  return figure;
};

const lineIn = (figure, colour, options = {}) => {
  const source = new Bokeh.ColumnDataSource({ data: { x: [], y: [] } });
  figure.line({ field: "x" }, { field: "y" }, { source, line_color: colour, line_width: 1.4, ...options });
  return source;
};

const dotsIn = (figure, colour, options = {}) => {
  const source = new Bokeh.ColumnDataSource({ data: { x: [], y: [] } });
  figure.scatter({ field: "x" }, { field: "y" }, { source, size: 4, line_color: null, fill_color: colour, ...options });
  return source;
};

const across = (figure, location, dash = "dashed") => {
  const span = new Bokeh.Span({ location, dimension: "width", line_color: INK.limit, line_dash: dash, line_width: 1.2 });
  figure.add_layout(span);
  return span;
};

// A range that grows at once and shrinks after three calm seconds, so that the axes stay readable.
class CalmRange {
  constructor(range, { symmetric = false, floor = 0.01, from = null }) {
    Object.assign(this, { range, symmetric, floor, from, calm: 0 });
  }
  fit(low, high, now) {
    if (!Number.isFinite(low) || !Number.isFinite(high)) return;
    if (this.symmetric) { high = Math.max(Math.abs(low), Math.abs(high)); low = -high; }
    if (this.from !== null) low = Math.min(this.from, low);
    const step = niceStep(Math.max(high - low, this.floor) / 4);
    const [start, end] = [this.from !== null ? low : Math.floor((low - 0.02 * (high - low)) / step) * step, Math.ceil((high + 0.02 * (high - low)) / step) * step];
    const { start: a, end: b } = this.range;
    const grows = start < a - 1e-12 || end > b + 1e-12;
    const loose = b - a > 1.9 * (end - start);
    if (!loose) this.calm = now;
    if (grows || (loose && now - this.calm > 3000)) { this.range.setv({ start, end: end > start ? end : start + step }); this.calm = now; }
  }
}

const niceStep = (rough) => {
  const power = 10 ** Math.floor(Math.log10(rough));
  const share = rough / power;
  return power * (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10);
};

const STRIP = {
  x: { name: "x", unit: "mm", digits: 3, lines: ["x"], symmetric: true },
  y: { name: "y", unit: "mm", digits: 3, lines: ["y"], symmetric: true },
  theta3: { name: "θ3", unit: "°", digits: 1, lines: ["theta3"], fixed: [-15, 365] },
  theta4: { name: "θ4", unit: "°", digits: 1, lines: ["theta4"], fixed: [-15, 365] },
  speed: { name: "speed", unit: "rpm", digits: 0, lines: ["target", "drive", "marks"], from: 0, floor: 40 },
};

class StripChart {
  constructor(parent, kind, limits, last) {
    this.kind = kind; this.how = STRIP[kind];
    this.element = document.createElement("div");
    this.element.className = `strip ${kind}`; this.element.id = `strip-${kind}`;
    this.element.setAttribute("role", "img");
    this.element.innerHTML = '<div class="head"><span class="name"></span><b></b><span class="note"></span><span class="how"></span></div><div class="plot"></div>';
    parent.append(this.element);
    const part = (name) => this.element.querySelector(name);
    this.value = part("b"); this.label = part(".how");
    part(".name").textContent = this.how.name; part(".name").style.color = INK[this.how.lines[0]] || INK.x;
    if (kind === "speed") { part(".name").style.color = INK.drive; part(".note").textContent = "drive ― target ┄ index marks ·"; }
    this.plot = part(".plot");
    const [low, high] = this.how.fixed || (this.how.symmetric ? [-0.1, 0.1] : [0, 10]);
    this.xRange = new Bokeh.Range1d({ start: 0, end: 1 });
    this.yRange = new Bokeh.Range1d({ start: low, end: high });
    this.figure = plotOf(this.plot, { x_range: this.xRange, y_range: this.yRange, min_border_left: 54, min_border_right: 8 });
    if (this.how.fixed) this.figure.yaxis.ticker = new Bokeh.FixedTicker({ ticks: [0, 90, 180, 270] });
    else this.figure.yaxis.ticker = new Bokeh.BasicTicker({ desired_num_ticks: 4 });
    if (!last) this.figure.xaxis.major_label_text_font_size = "0px";
    else this.figure.xaxis.axis_label = "s since the start";
    this.calm = this.how.fixed ? null : new CalmRange(this.yRange, this.how);
    this.sources = {};
    for (const name of this.how.lines) {
      this.sources[name] = name === "marks" ? dotsIn(this.figure, INK.marks, { size: 3 })
        : lineIn(this.figure, INK[name], name === "target" ? { line_dash: "dashed", line_width: 1 } : {});
    }
    if (this.how.symmetric) for (const sign of [-1, 1]) across(this.figure, sign * limits.amplitude_mm);
    if (kind === "speed") across(this.figure, limits.speed_rpm);
  }
  draw({ header, columns }, now) {
    let low = Infinity, high = -Infinity, bucket = 0;
    for (const name of this.how.lines) {
      const time = columns[`${name}.t`];
      if (!time) continue;
      const lows = columns[`${name}.low`], highs = columns[`${name}.high`];
      const n = time.length, twice = highs ? 2 : 1;
      const x = new Float64Array(twice * n), y = new Float64Array(twice * n);
      for (let i = 0; i < n; i += 1) {
        const at = header.end_s + time[i];
        if (highs) { x[2 * i] = at; x[2 * i + 1] = at; y[2 * i] = lows[i]; y[2 * i + 1] = highs[i]; }
        else { x[i] = at; y[i] = lows[i]; }
        if (lows[i] < low) low = lows[i];
        const top = highs ? highs[i] : lows[i];
        if (top > high) high = top;
      }
      this.sources[name].data = { x, y };
      bucket = Math.max(bucket, header.buckets[name] || 0);
    }
    this.label.textContent = bucket ? `min–max of ${spanWords(bucket)}` : "samples";
    this.xRange.setv({ start: header.start_s, end: header.end_s });
    if (this.calm) this.calm.fit(low, high, now);
  }
  showValue(value, stale) {
    const text = value === null || value === undefined ? "–" : `${rounded(value, this.how.digits)} ${this.how.unit}`;
    this.value.textContent = text;
    this.element.classList.toggle("stale", stale);
    this.spoken = `${this.how.name} over time, now ${stale ? "stale" : text}`;
  }
}

const rounded = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]*$)/, ""); // no "-0.0"
const spanWords = (s) => (s < 1 ? `${(1000 * s).toPrecision(3)} ms` : `${s.toPrecision(3)} s`);

class Orbit {
  constructor(element, limits) {
    this.limit = limits.amplitude_mm; this.legend = element.querySelector(".legend");
    this.legend.textContent = "measured\u00a0― model\u00a0┄";
    this.ranges = [0, 1].map(() => new Bokeh.Range1d({ start: -0.1, end: 0.1 }));
    this.figure = plotOf(element.querySelector(".plot"), { x_range: this.ranges[0], y_range: this.ranges[1], match_aspect: true });
    this.figure.xaxis.axis_label = "x, mm"; this.figure.yaxis.axis_label = "y, mm";
    for (const axis of [this.figure.xaxis, this.figure.yaxis]) axis.ticker = new Bokeh.BasicTicker({ desired_num_ticks: 4 });
    this.track = lineIn(this.figure, INK.x, { line_width: 1.8 });
    this.model = lineIn(this.figure, INK.model, { line_dash: [5, 4], line_width: 1.6 });
    this.now = dotsIn(this.figure, INK.y, { size: 8 });
    this.calm = new CalmRange(new Bokeh.Range1d({ start: -0.1, end: 0.1 }), { symmetric: true, floor: 0.02 });
  }
  draw({ columns }, now) {
    const x = columns["orbit.x"] || [], y = columns["orbit.y"] || [];
    this.track.data = { x, y };
    this.model.data = { x: columns["model.x"] || [], y: columns["model.y"] || [] };
    const n = x.length;
    this.now.data = n ? { x: [x[n - 1]], y: [y[n - 1]] } : { x: [], y: [] };
    let most = 0;
    for (const values of [x, y, columns["model.x"] || [], columns["model.y"] || []]) for (const v of values) if (Math.abs(v) > most) most = Math.abs(v);
    this.calm.fit(-most, most, now);
    const { start, end } = this.calm.range, wide = (this.figure.inner_width || 1) / (this.figure.inner_height || 1);
    const scale = Number.isFinite(wide) && wide > 0 ? wide : 1; // keeps circles round for every shape of the panel
    this.ranges[0].setv({ start: start * Math.max(1, scale), end: end * Math.max(1, scale) });
    this.ranges[1].setv({ start: start * Math.max(1, 1 / scale), end: end * Math.max(1, 1 / scale) });
  }
}

class Bode {
  constructor(element, { header, columns }) {
    element.querySelector(".legend").innerHTML = 'measured&nbsp;●△, steady response,&nbsp;model&nbsp;―┄<span class="ramp" hidden>, this&nbsp;ramp,&nbsp;model&nbsp;<span class="kr">―┄</span></span>: <span class="kx">x&nbsp;●&nbsp;―</span> <span class="ky">y&nbsp;△&nbsp;┄</span> phase wrapped to&nbsp;±180°, lead&nbsp;positive<span class="stamps"></span>';
    this.stamps = element.querySelector(".stamps");
    this.ramp = element.querySelector(".ramp"); element.querySelector(".kr").style.color = INK.model;
    element.querySelector(".kx").style.color = INK.x; element.querySelector(".ky").style.color = INK.y;
    const border = () => ({ x_range: new Bokeh.Range1d({ start: 0, end: header.speed_rpm }), min_border_left: 60, min_border_right: 8 });
    const rpm = columns["model.rpm"];
    this.amplitudeRange = new Bokeh.Range1d({ start: 0, end: 1 });
    this.calm = new CalmRange(this.amplitudeRange, { from: 0, floor: 0.1 });
    const amplitude = plotOf(element.querySelector(".amplitude"), { ...border(), y_range: this.amplitudeRange });
    amplitude.yaxis.axis_label = "mm (0–peak)"; amplitude.xaxis.major_label_text_font_size = "0px";
    across(amplitude, header.amplitude_mm);
    const phase = plotOf(element.querySelector(".phase"), { ...border(), y_range: new Bokeh.Range1d({ start: -180, end: 180 }) });
    phase.yaxis.axis_label = "phase, °"; phase.xaxis.axis_label = "rpm";
    phase.yaxis.ticker = new Bokeh.FixedTicker({ ticks: [-180, -90, 0, 90, 180] });
    this.figures = { amplitude, phase }; this.measured = {}; this.planned = {}; this.most = 0;
    for (const axis of ["x", "y"]) {
      const model = polar(columns[`model.${axis}.re`], columns[`model.${axis}.im`]);
      for (const v of model.amplitude) if (v > this.most) this.most = v;
      const line = { line_alpha: 0.8, line_dash: axis === "y" ? [6, 4] : [] }; // distinguishable in grey, too
      const dots = axis === "y" ? { marker: "triangle", line_color: INK.y, fill_color: null } : {};
      lineIn(amplitude, INK[axis], line).data = { x: rpm, y: model.amplitude };
      lineIn(phase, INK[axis], line).data = broken(rpm, model.phase);
      const white = { line_alpha: 0.9, line_width: 1.1, line_dash: line.line_dash };
      this.planned[axis] = [lineIn(amplitude, INK.model, white), lineIn(phase, INK.model, white)];
      this.measured[axis] = [dotsIn(amplitude, INK[axis], { size: 5, ...dots }), dotsIn(phase, INK[axis], { size: 4, ...dots })];
    }
    this.calm.fit(0, Math.min(this.most, 1.3 * header.amplitude_mm), 0);
  }
  draw({ header, columns }, now) {
    const rpm = columns["bode.rpm"] || [], ahead = columns["ramp.rpm"] || [];
    const stamps = rpm.length ? Object.entries(header.stamps).map(([axis, stamp]) => stampWords(axis, stamp, rpm[rpm.length - 1])).join("") : "";
    if (this.stamps.textContent !== stamps) this.stamps.textContent = stamps;
    let most = 0;
    this.ramp.hidden = !ahead.length;
    for (const axis of ["x", "y"]) {
      const found = polar(columns[`bode.${axis}.re`], columns[`bode.${axis}.im`]);
      this.measured[axis][0].data = { x: rpm, y: found.amplitude };
      this.measured[axis][1].data = { x: rpm, y: found.phase };
      const planned = polar(columns[`ramp.${axis}.re`], columns[`ramp.${axis}.im`]);
      this.planned[axis][0].data = { x: ahead, y: planned.amplitude };
      this.planned[axis][1].data = broken(ahead, planned.phase);
      for (const v of [...found.amplitude, ...planned.amplitude]) if (v > most) most = v;
    }
    this.calm.fit(0, Math.max(most, this.most), now);
    return rpm.length;
  }
}

const TIMES = 1.96; // standard deviations of half a 95 % interval
const stampWords = (axis, { lag_ms: lag, std_ms: std, known }, rpm) => { // how far a phase is known, at the newest speed
  if (!std) return "";
  const half = Math.min(180, TIMES * std * 1e-3 * 6 * Math.abs(rpm)); // 6° per second and rpm
  const shift = known ? `without ${Math.abs(lag).toFixed(1)} ms by which its stamps are ${lag > 0 ? "late" : "early"}` : "stamps' shift unknown";
  return `; phase of ${axis} ± ${half < 10 ? half.toFixed(1) : half.toFixed(0)}° at ${rpm.toFixed(0)} rpm (95 %, ${shift})`;
};

const polar = (re = [], im = []) => {
  const amplitude = new Float64Array(re.length), phase = new Float64Array(re.length);
  for (let i = 0; i < re.length; i += 1) {
    amplitude[i] = Math.hypot(re[i], im[i]);
    phase[i] = Math.atan2(im[i], re[i]) * 180 / Math.PI;
  }
  return { amplitude, phase };
};

const broken = (x, y) => { // interrupts the line where it jumps by a turn
  const out = { x: [], y: [] };
  for (let i = 0; i < x.length; i += 1) {
    if (i && Math.abs(y[i] - y[i - 1]) > 180) { out.x.push(x[i]); out.y.push(NaN); }
    out.x.push(x[i]); out.y.push(y[i]);
  }
  return out;
};

class Tracked {
  constructor(element) {
    element.querySelector(".legend").innerHTML = '<span class="k3">c3</span> <span class="k4">c4</span>, ± 1 std; rig file ┄ <span class="locked"></span>';
    this.note = element.querySelector(".locked");
    element.querySelector(".k3").style.color = INK.theta3; element.querySelector(".k4").style.color = INK.theta4;
    this.xRange = new Bokeh.Range1d({ start: 0, end: 10 });
    this.yRange = new Bokeh.Range1d({ start: 0, end: 2 });
    this.calm = new CalmRange(this.yRange, { from: 0, floor: 0.1 });
    this.figure = plotOf(element.querySelector(".plot"), { x_range: this.xRange, y_range: this.yRange, min_border_left: 50, min_border_right: 8 });
    this.figure.yaxis.axis_label = "mN·m·s/rad"; this.figure.xaxis.axis_label = "s since the start";
    this.parts = {};
    for (const [name, colour] of [["c3", INK.theta3], ["c4", INK.theta4]]) {
      const band = new Bokeh.ColumnDataSource({ data: { x: [], low: [], high: [] } });
      this.figure.varea({ x: { field: "x" }, y1: { field: "low" }, y2: { field: "high" }, source: band, fill_color: colour, fill_alpha: 0.2 });
      this.parts[name] = { band, line: lineIn(this.figure, colour, { line_width: 2 }), start: lineIn(this.figure, colour, { line_dash: "dashed", line_width: 1 }) };
    }
  }
  draw({ header, columns }, now) {
    const locked = header.locked || [];
    this.note.textContent = locked.length ? `${locked.join(" and ")} locked: no damping` : "";
    const time = columns["tracked.t"] || [];
    const first_s = header.since_s, end = Math.max(first_s + 10, header.now_s);
    let most = 0;
    ["c3", "c4"].forEach((name, i) => {
      const value = columns[`tracked.${name}`] || [], std = columns[`tracked.${name}_std`] || [];
      const y = Float64Array.from(value, (v) => 1e3 * v);
      const low = Float64Array.from(value, (v, k) => 1e3 * (v - std[k])), high = Float64Array.from(value, (v, k) => 1e3 * (v + std[k]));
      const { band, line, start } = this.parts[name];
      band.data = { x: time, low, high }; line.data = { x: time, y };
      const first = header.start ? 1e3 * header.start[i] : NaN;
      start.data = { x: [first_s, end], y: [first, first] };
      most = Math.max(most, first || 0, y.length ? 1.3 * (y[y.length - 1] || 0) : 0);
    });
    this.xRange.setv({ start: first_s, end });
    this.calm.fit(0, 1.2 * most, now);
  }
}

// Pendulum angles in the rotor's frame, counter-clockwise from the imbalance; predicted positions hollow.
class Dial {
  constructor(element) {
    this.svg = element.querySelector(".plot"); this.legend = element.querySelector(".legend");
    this.svg.innerHTML = '<svg viewBox="-64 -60 128 120" width="100%" height="100%" aria-hidden="true"><g class="scale"></g><g class="predicted"></g><g class="arms"></g></svg>';
    const ticks = [];
    for (let a = 0; a < 360; a += 15) {
      const [x, y] = this.at(a, 46), [u, v] = this.at(a, a % 90 ? 43.5 : 41);
      ticks.push(`<line x1="${x}" y1="${y}" x2="${u}" y2="${v}" stroke="#3b4c5e"/>`);
    }
    for (const a of [0, 90, 180, 270]) { const [x, y] = this.at(a, 53); ticks.push(`<text x="${x}" y="${y + 3}" text-anchor="middle">${a}°</text>`); }
    this.svg.querySelector(".scale").innerHTML = `<circle r="46" fill="#121921" stroke="#3b4c5e"/>${ticks.join("")}<path d="M 0 0 L 38 0" stroke="#6b7d8f" stroke-dasharray="2 3"/>`;
  }
  at(degrees, r) { const a = degrees * Math.PI / 180; return [r * Math.cos(a), -r * Math.sin(a)]; }
  draw({ header }) {
    const colours = [INK.theta3, INK.theta4];
    this.svg.querySelector(".arms").innerHTML = header.theta.map((angle, i) => {
      if (angle === null) return "";
      const [x, y] = this.at(angle, 34 - 6 * i);
      return `<line x1="0" y1="0" x2="${x}" y2="${y}" stroke="${colours[i]}" stroke-width="2.5"/><circle cx="${x}" cy="${y}" r="4.5" fill="${colours[i]}"/>`;
    }).join("");
    this.svg.querySelector(".predicted").innerHTML = header.predicted.map((state) => state.theta_deg.map((angle, i) => {
      const [x, y] = this.at(angle, 34 - 6 * i);
      return `<circle cx="${x}" cy="${y}" r="7" fill="none" stroke="${colours[i]}" stroke-width="1.4" stroke-dasharray="3 2"/>`;
    }).join("")).join("");
    const [a, b] = header.theta.map((v) => (v === null ? "–" : `${rounded(v, 1)}°`));
    const types = [...new Set(header.predicted.map((state) => state.type))].join(", ");
    const locks = header.locked ? "locked" : header.locked === false ? "free" : "";
    const model = types && types !== "locked" ? `◌ model: type ${types}` : types ? "◌ model" : header.why ? `no model: ${header.why}` : "no model";
    this.legend.textContent = [locks, model].filter(Boolean).join(types ? "  " : ", ");
    this.spoken = `pendulums: θ3 ${a}, θ4 ${b}; predicted ${header.predicted.map((s) => `${s.type} at ${s.theta_deg.map((v) => rounded(v, 1)).join("° and ")}°`).join(", ") || header.why}`;
  }
}
