"use strict";
// Panels in words: limits, lamps, test, streams, events.
const byId = (id) => document.getElementById(id);
const numberOf = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
const LARGE = ["amplitude", "overspeed"];

class Limits {
  constructor(element) { this.rows = element.querySelector(".rows"); this.known = new Map(); }
  show(limits) {
    let nearest = null;
    limits.forEach((limit) => {
      const key = `${limit.interlock} ${limit.what}`;
      if (!this.known.has(key)) this.known.set(key, this.row(limit));
      const row = this.known.get(key), used = limit.used;
      const words = limit.value === null || limit.limit === null ? "unknown" : `${three(limit.value)} of ${three(limit.limit)} ${limit.unit}`;
      row.querySelector(".value").textContent = words;
      row.querySelector(".used").textContent = used === null ? "–" : `${Math.round(100 * used)} %`;
      row.querySelector(".fill").style.width = `${Math.min(100, 100 * (used || 0))}%`;
      row.classList.toggle("near", used >= 0.8 && used < 1); row.classList.toggle("beyond", used >= 1);
      const meter = row.querySelector(".track");
      meter.setAttribute("aria-valuenow", Math.round(100 * (used || 0))); meter.setAttribute("aria-valuetext", words);
      if (used !== null && (nearest === null || used > nearest.used)) nearest = limit;
    });
    return nearest;
  }
  row(limit) {
    const row = document.createElement("div");
    row.className = `limit${LARGE.includes(limit.interlock) ? " main" : ""}`;
    row.innerHTML = '<span class="what"></span><span class="value"></span><span class="used"></span><div class="track" role="meter" aria-valuemin="0" aria-valuemax="100"><div class="fill"></div></div>';
    row.querySelector(".what").textContent = limit.what;
    row.querySelector(".track").setAttribute("aria-label", `${limit.interlock}: ${limit.what}`);
    this.rows.append(row);
    return row;
  }
}

const three = (v) => (v === 0 ? "0" : Math.abs(v) >= 100 ? v.toFixed(0) : Math.abs(v) < 0.1 ? v.toFixed(3) : v.toPrecision(3));

const STATE_WORDS = { quiet: "", near: "near", beyond: "now", tripped: "TRIPPED", recovered: "recovered" };

const showLamps = (list, lamps) => {
  const order = ["tripped", "beyond", "recovered", "near", "quiet"];
  const sorted = [...lamps].sort((a, b) => order.indexOf(a.state) - order.indexOf(b.state));
  replaceWhenChanged(list, sorted.map((lamp) => `${lamp.name}|${lamp.state}|${lamp.text}`).join("\n"), () => sorted.map((lamp) => {
    const item = document.createElement("li");
    item.className = lamp.state;
    item.title = `${lamp.guards}; ${lamp.threshold}; ${lamp.reaction}`;
    const words = lamp.state === "quiet" || lamp.state === "near" ? "" : `: ${STATE_WORDS[lamp.state]} (${lamp.since_s.toFixed(1)} s) ${lamp.text}`;
    item.textContent = `${lamp.name}${words}`;
    item.setAttribute("aria-label", `${lamp.name}: ${lamp.state} ${lamp.text}`);
    return item;
  }));
};

const replaceWhenChanged = (element, key, make) => {
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.replaceChildren(...make());
};

const showTest = (element, state) => {
  const part = (name) => element.querySelector(name);
  const test = [state.test, state.point && !state.test.endsWith(state.point) ? state.point : ""].filter(Boolean).join(" ");
  const step = test ? `${test}${state.step ? `: ${state.step}` : ""}` : "no test runs", over = state.ended || state.stopping;
  const log = (state.log || "").split(/[\\/]/).pop();
  part(".step").textContent = state.ended ? `run ended${log ? `: ${log}` : ""}` : step;
  part(".words").textContent = state.ended ? (test ? `last step: ${step}` : state.note || "") : state.words || state.note || "";
  part(".prompt").hidden = over || !state.prompt; part(".prompt").textContent = state.prompt || "";
  part("progress").hidden = over || state.share === null; if (state.share !== null) part("progress").value = state.share;
  element.querySelectorAll("[data-verb]").forEach((button) => { // unavailable buttons stay in place, disabled
    const can = state.mode !== "replay" && state.can.includes(button.dataset.verb);
    if (!over || state.mode === "replay") button.hidden = !can;
    button.disabled = !can;
  });
  if (!over) byId("note").hidden = !state.can.includes("note");
  byId("note").querySelectorAll("input, button").forEach((control) => { control.disabled = !state.can.includes("note"); });
  if (state.answer) part(".answer").textContent = state.answer;
};

const CLOSED_WORDS = { timed_out: "connections without a request closed", displaced: "closed for newer ones", refused: "refused", busy: "turned away" };

const showHealth = (list, state) => {
  const rows = [];
  for (const [device, kinds] of Object.entries(state.losses || {})) {
    const lost = Object.entries(kinds).filter(([, n]) => n).map(([kind, n]) => `${n} ${(n === 1 ? kind.replace(/(?<!_ms)s$/, "") : kind).replaceAll("_", " ")}`);
    rows.push([device, lost.join(", ") || "nothing lost", lost.length > 0]);
  }
  if (state.rates) rows.push(["rates", state.rates, true]);
  if (state.disk) rows.push(["disk", `${(state.disk.written_bytes / 1e6).toFixed(1)} MB written${state.disk.slow ? ", SLOW" : ""}`, state.disk.slow]);
  if (state.feed_dropped) rows.push(["page's feed", `${numberOf(state.feed_dropped, "sample")} left out here (the log has them)`, true]);
  for (const [address, kinds] of Object.entries(state.connections || {})) rows.push([`from ${address}`, Object.entries(kinds).map(([kind, n]) => `${n} ${n === 1 ? CLOSED_WORDS[kind].replace("connections", "connection") : CLOSED_WORDS[kind]}`).join(", "), true]);
  if (state.dropped_viewers) rows.push(["viewers", `${state.dropped_viewers} disconnected: invalid or too many messages`, true]);
  rows.push(["viewers", `${state.viewers}${state.missed ? `; this one missed ${numberOf(state.missed, "frame")}` : ""}`, false]);
  replaceWhenChanged(list, JSON.stringify(rows), () => rows.flatMap(([name, words, bad]) => {
    const term = document.createElement("dt"), detail = document.createElement("dd");
    term.textContent = name; detail.textContent = words; detail.className = bad ? "bad" : "";
    return [term, detail];
  }));
};

const showEvents = (list, events) => {
  replaceWhenChanged(list, events.map((event) => `${event.at_s}${event.text}`).join("|"), () => [...events].reverse().map((event) => {
    const item = document.createElement("li"), time = document.createElement("time"), words = document.createElement("span");
    time.textContent = `${event.at_s.toFixed(2)} s`; words.textContent = `${event.device ? `${event.device}: ` : ""}${event.text || event.kind}`;
    item.append(time, words);
    return item;
  }));
};
