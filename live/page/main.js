"use strict";
// Connection to the server, and the viewer's input.
const token = new URLSearchParams(location.search).get("token") || "";
const post = async (path, body) => {
  const answer = await fetch(`${path}?token=${encodeURIComponent(token)}`, {
    method: "POST", cache: "no-store", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body || {}),
  });
  const result = await answer.json().catch(() => ({ error: `answer ${answer.status}` }));
  if (!answer.ok || result.error) throw new Error(result.error || `answer ${answer.status}`);
  return result;
};
const page = { socket: null, charts: [], curves: null, frame: null, slow: null, heard: 0, held: null, window: 10, drawn: 0, state: null, tries: 0, turned: 0, rests: 0, drew: false, stopped: -Infinity, acts: 0 };
const BUSY_MS = 50, MOST_REST_MS = 200; // between two frames of the browser, one of which drew; a sleeping tab has no frames for hours
const strips = byId("charts");

const connect = () => {
  const socket = new WebSocket(`ws://${location.host}/data?token=${encodeURIComponent(token)}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { page.tries = 0; };
  socket.onmessage = ({ data }) => {
    page.heard = performance.now();
    if (typeof data === "string") { takeState(JSON.parse(data)); return; }
    const picture = decodePicture(data);
    if (picture.header.kind === "curves") build(picture);
    else if (picture.header.kind === "slow") page.slow = picture;
    else { page.frame = picture; if (document.hidden) seen(picture.header.number); }
  };
  socket.onclose = () => { if (ended()) return; page.tries += 1; setTimeout(connect, Math.min(5000, 250 * page.tries)); };
  page.socket = socket;
};
const ended = () => !!page.state && !!page.state.ended;
const send = (message) => { if (page.socket && page.socket.readyState === 1) page.socket.send(JSON.stringify(message)); };
const seen = (number) => send({ seen: number });
const sendView = () => {
  const width = page.charts.length ? Math.max(50, page.charts[0].plot.clientWidth - 62) : 600;
  send({ view: { window_s: page.window, end_s: page.held, pixels: Math.round(width) } });
};

const build = (picture) => {
  if (page.curves) { sendView(); return; } // the connection was restored
  page.curves = picture;
  const limits = picture.header;
  page.charts = limits.strips.map((kind, i) => new StripChart(strips, kind, limits, i === limits.strips.length - 1));
  page.orbit = new Orbit(byId("orbit"), limits); page.dial = new Dial(byId("dial"));
  page.bode = new Bode(byId("bode"), picture); page.tracked = new Tracked(byId("tracked"));
  page.limits = new Limits(byId("limits"));
  for (const id of ["orbit", "dial", "bode", "tracked"]) byId(id).setAttribute("role", "img");
  byId("bode").setAttribute("aria-label", `1× Bode diagram; the model is the ${limits.model}'s`);
  new ResizeObserver(sendView).observe(strips);
  sendView();
};

const draw = () => {
  requestAnimationFrame(draw);
  const now = performance.now(), took = now - page.turned;
  page.turned = now;
  markLink(now);
  if (page.drew && took > BUSY_MS) page.rests = now + Math.min(took, MOST_REST_MS); // on a busy machine half of the time remains for STOP
  page.drew = false;
  if (now < page.rests) return;
  if (page.slow && page.bode) {
    const count = page.bode.draw(page.slow, now); page.tracked.draw(page.slow, now); page.slow.count = count; page.slow = null;
  }
  const picture = page.frame;
  if (!picture || !page.curves) return;
  page.frame = null; page.drew = true;
  const { header } = picture;
  for (const chart of page.charts) chart.draw(picture, now);
  page.orbit.draw(picture, now); page.dial.draw(picture);
  page.last = header; page.drawn += 1;
  seen(header.number);
  words(header);
};

const STALE_OF = { x: ["strip-x", "orbit"], y: ["strip-y", "orbit"], angles: ["strip-theta3", "strip-theta4", "dial"], speed: ["strip-speed"] };
const words = (header) => {
  const limit = page.curves.header.stale_s;
  const none = (name) => name in header.ages_s && header.ages_s[name] === null; // no sample up to the displayed instant
  const old = (name) => !ended() && header.ages_s[name] > limit;
  const waits = Object.keys(header.ages_s).every(none) ? "waiting for the rig" : "no data yet";
  const values = { x: header.last[0], y: header.last[1], theta3: header.theta[0], theta4: header.theta[1], speed: header.rpm };
  const group = { x: "x", y: "y", theta3: "angles", theta4: "angles", speed: "speed" };
  for (const chart of page.charts) { chart.showValue(values[chart.kind], old(group[chart.kind])); mark(chart.element, none(group[chart.kind]) ? waits : ""); }
  for (const [id, names] of [["orbit", ["x", "y"]], ["dial", ["angles"]]]) {
    byId(id).classList.toggle("stale", names.some(old));
    mark(byId(id), names.some(none) ? waits : "");
  }
  byId("rpm").querySelector(".share").textContent = header.rpm === null ? "–" : header.rpm.toFixed(0);
};

const mark = (panel, waits) => { if (waits) panel.dataset.waits = ended() ? "no data" : waits; else delete panel.dataset.waits; };

const markLink = (now) => {
  const silent = (now - page.heard) / 1000, link = byId("link");
  const over = ended(), gone = !over && (!page.socket || page.socket.readyState !== 1 || silent > 0.7);
  link.classList.toggle("stale", gone); link.classList.toggle("ended", over);
  const text = over ? "run ended" : gone ? (page.heard ? `STALE ${silent.toFixed(0)} s` : "connecting") : page.held !== null ? "held" : page.state && page.state.mode === "replay" ? "replay" : "live";
  if (link.textContent !== text) link.textContent = text;
  if (gone && page.heard) for (const panel of document.querySelectorAll(".strip, #orbit, #dial")) panel.classList.add("stale");
};

const takeState = (state) => {
  page.state = state;
  document.body.dataset.mode = state.mode;
  document.title = `${state.title} – rig live`;
  if (state.ended) for (const panel of document.querySelectorAll(".strip, #orbit, #dial")) panel.classList.remove("stale");
  byId("title").textContent = state.title;
  byId("subtitle").textContent = [state.ended ? "run ended" : state.mode === "replay" ? "replay of a log" : state.mode, state.started, state.log].filter(Boolean).join("   ");
  if (!page.limits) return;
  const nearest = page.limits.show(state.limits), big = byId("nearest");
  big.querySelector(".share").textContent = nearest ? `${Math.round(100 * nearest.used)} %` : "–";
  big.querySelector(".what").textContent = nearest ? `nearest limit: ${nearest.interlock}` : "nearest limit";
  big.classList.toggle("near", !!nearest && nearest.used >= 0.8 && nearest.used < 1); big.classList.toggle("beyond", !!nearest && nearest.used >= 1);
  showLamps(byId("lamps").querySelector("ul"), state.lamps);
  showTest(byId("test"), state); showHealth(byId("health").querySelector("dl"), state); showEvents(byId("events").querySelector("ol"), state.events);
  byId("stop").disabled = state.ended || !!state.stop; byId("stop").title = state.stop || ""; // else pressed at any time: STOP does not wait for a state
  alertOf(state.trouble || "");
  showTransport(state);
  for (const chart of page.charts) if (chart.spoken) chart.element.setAttribute("aria-label", chart.spoken);
  if (page.dial.spoken) byId("dial").setAttribute("aria-label", page.dial.spoken);
  byId("orbit").setAttribute("aria-label", "orbit of the disk centre, measured and model");
  byId("tracked").setAttribute("aria-label", "tracked damping c3 and c4 over time");
};

const alertOf = (text) => { const alert = byId("alert"); if (alert.textContent !== text) { alert.textContent = text; alert.hidden = !text; } };

const showTransport = (state) => {
  byId("transport").hidden = state.mode !== "replay";
  if (state.mode !== "replay") return;
  byId("play").textContent = state.playing ? "pause" : "play";
  const seek = byId("seek");
  seek.max = state.end_s;
  if (document.activeElement !== seek || !page.dragging) seek.value = state.now_s;
  byId("position").textContent = `${state.now_s.toFixed(1)} s of ${state.end_s.toFixed(1)} s`;
  byId("speed").value = String(state.speed);
};

const MOST_ACTS = 3; // without an answer: a browser has six connections to one address, and STOP needs one
const act = (verb, given) => {
  if (page.acts >= MOST_ACTS && page.state && page.state.mode !== "replay") { failed(new Error(`${verb}: earlier commands have no answer yet`)); return Promise.resolve(); }
  page.acts += 1;
  return post("act", { verb, ...given }).then((result) => { byId("test").querySelector(".answer").textContent = result.answer || ""; }).catch(failed).finally(() => { page.acts -= 1; });
};
const failed = (error) => { alertOf(error.message); };

const stop = () => {
  const button = byId("stop"), since = performance.now();
  if (button.disabled || since - page.stopped < 500) return; // a press and its click count once
  page.stopped = since;
  button.classList.add("sent");
  post("stop").then(() => { button.firstChild.textContent = "STOPPED"; byId("test").querySelector(".answer").textContent = `the stop was ordered ${(performance.now() - since).toFixed(0)} ms after the click`; })
    .catch((error) => { page.stopped = -Infinity; button.classList.remove("sent"); alertOf(`STOP FAILED: ${error.message}. Use the emergency stop at the rig`); });
};

const setWindow = (seconds) => {
  page.window = Math.min(36000, Math.max(0.02, seconds));
  const select = byId("window"), known = [...select.options].find((option) => Number(option.value) === page.window);
  if (known) select.value = known.value; else { let own = select.querySelector(".own"); if (!own) { own = new Option("", ""); own.className = "own"; select.append(own); } own.value = String(page.window); own.textContent = spanWords(page.window); select.value = own.value; }
  sendView();
};

byId("stop").addEventListener("click", stop);
byId("stop").addEventListener("pointerdown", (event) => { if (event.pointerType === "mouse" && event.button === 0) stop(); }); // a touch may start scrolling
byId("window").addEventListener("change", (event) => setWindow(Number(event.target.value)));
byId("zoom-in").addEventListener("click", () => setWindow(page.window / 2));
byId("zoom-out").addEventListener("click", () => setWindow(page.window * 2));
strips.addEventListener("wheel", (event) => { event.preventDefault(); setWindow(page.window * (event.deltaY > 0 ? 1.25 : 0.8)); }, { passive: false });
byId("hold").addEventListener("click", (event) => {
  page.held = page.held === null && page.last ? page.last.end_s : null;
  event.target.setAttribute("aria-pressed", String(page.held !== null)); event.target.textContent = page.held === null ? "hold" : "follow";
  sendView();
});
byId("play").addEventListener("click", () => act(page.state && page.state.playing ? "pause" : "play", {}));
byId("seek").addEventListener("input", (event) => { page.dragging = true; act("seek", { to_s: Number(event.target.value) }); });
byId("seek").addEventListener("change", () => { page.dragging = false; });
byId("speed").addEventListener("change", (event) => act("speed", { speed: Number(event.target.value) }));
byId("test").addEventListener("click", (event) => { const verb = event.target.dataset.verb; if (verb) act(verb, {}); });
byId("note").addEventListener("submit", (event) => {
  event.preventDefault();
  const field = event.target.querySelector("input"), text = field.value.trim();
  if (text) act("note", { text }).then(() => { field.value = ""; });
});
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "s" || event.key === "S") stop();
  else if (event.key === " " && page.state && page.state.mode === "replay" && event.target.tagName !== "BUTTON") { event.preventDefault(); byId("play").click(); }
});
connect();
requestAnimationFrame(draw);
