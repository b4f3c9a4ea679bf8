// The page of `omnibus serve`. It shows the messages of the backend (`backend.js` beside it) and sends the user's actions;
// what may move, the backend decides. Nothing is loaded from anywhere else.
"use strict";

const $ = (id) => document.getElementById(id);
const SEND_MS = 50; // a press is repeated this often; the server takes it for over after 250 ms
const TRAIL_M = 0.02; // distance of two points of the trail
const TRAIL_POINTS = 4000;
const STALE_MS = 1000; // a state older than this is shown as lost
const OLD_MS = 250; // five states that did not come: what is shown is no longer the present
const PLOT_S = 60; // seconds that the plot shows, until it is zoomed
const PLOT_SHORTEST_S = 3;
const PLOT_LONGEST_S = 600; // samples are kept for so long
const KEEP_MS = 1000; // how often the trail is kept for a reload

let backend = null;
let token = "";
let welcome = null;
let state = null;
let stateAt = 0;
let trusted = false;
let seat = { yours: false, taken: false };
let trail = [];
let aims = []; // the path that the newest curve asked for

// ---- connection -------------------------------------------------------------------------------------------

function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    // Out of the address bar: it would be in every screenshot.
    history.replaceState(null, "", location.pathname);
    sessionStorage.setItem("token", given);
  }
  token = given || sessionStorage.getItem("token") || "";
}

function send(message) {
  if (backend) backend.send(message);
}

function connect() {
  backend = openBackend({
    opened: () => { if (token) send({ type: "hello", token }); },
    received: receive,
    closed: () => {
      release();
      trusted = false;
      seat = { yours: false, taken: false };
      state = null;
      show();
    },
  });
}

function receive(message) {
  if (message.type === "welcome") {
    welcome = message;
    recall();
    document.title = `${message.group} - Omnibus`;
    $("group").textContent = message.group;
    $("bus").textContent = message.bus;
    build();
  } else if (message.type === "trusted") {
    trusted = true;
    say("");
  } else if (message.type === "seat") {
    if (seat.yours && !message.yours) release();
    seat = message;
  } else if (message.type === "state") {
    state = message;
    stateAt = performance.now();
    follow();
    remember();
    progress();
  } else if (message.type === "event") {
    log(message);
  } else if (message.type === "refused") {
    if (message.reason === "wrong token") {
      token = "";
      sessionStorage.removeItem("token");
    }
    release();
    say(message.reason);
  }
  if (message.type !== "event") show();
}

// The trail and the last place survive a reload of the page: robots that are not started do not say where they are.
let keptAt = 0;

function keep() {
  if (!welcome || performance.now() - keptAt < KEEP_MS) return;
  keptAt = performance.now();
  sessionStorage.setItem("trail", JSON.stringify({ group: welcome.group, bus: welcome.bus, trail, here }));
}

function recall() {
  trail = [];
  aims = [];
  let kept = null;
  try { kept = JSON.parse(sessionStorage.getItem("trail")); } catch { kept = null; }
  // A simulated bus starts again with the server, whose clock then is younger than what was kept.
  if (kept && kept.group === welcome.group && kept.bus === welcome.bus) ({ trail, here } = kept);
}

function say(text, info) {
  $("message").textContent = text;
  $("message").className = info ? "info" : "";
}

function log(event) {
  const line = document.createElement("li");
  line.className = event.level;
  for (const text of [`${event.t.toFixed(2)} s`, event.who, event.text]) {
    const cell = document.createElement("span");
    cell.textContent = text;
    line.append(cell);
  }
  $("log").prepend(line);
  while ($("log").children.length > 60) $("log").lastChild.remove();
}

// ---- gauges -----------------------------------------------------------------------------------------------

function element(kind, className, text) {
  const made = document.createElement(kind);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

const gauges = {};
const robots = {};

function bar() {
  const outer = element("div", "bar");
  outer.append(element("i"));
  return outer;
}

function build() {
  $("curve").replaceChildren(...(welcome.curves || []).map((name) => element("option", "", name)));
  $("gauges").replaceChildren();
  for (const [name, label, hasBar, meaning] of [
    ["speed", "Speed", true, "Measured speed of the group, over the limit of the group file"],
    ["yaw", "Yaw rate", true, "How fast the group turns, over the limit of the group file"],
    ["scale", "Group scale", true, "Share of the commanded speed that all robots can follow; below 100 % a wheel is at its limit"],
    ["strain", "Strain", false, "How far the robots disagree about the group's motion: the load between them takes up the difference"],
    ["slip", "Largest slip", false, "Wheel rates that no motion of a rigid robot explains"],
    ["load", "Bus load", true, "Share of the bus that frames took in the last 100 ms"]]) {
    const gauge = element("div", "gauge");
    gauge.title = meaning;
    gauge.append(element("span", "", label), element("b", "", "-"));
    if (hasBar) gauge.append(bar());
    gauge.id = `gauge-${name}`;
    gauges[name] = gauge;
    $("gauges").append(gauge);
  }
  $("robots").replaceChildren();
  for (const { node } of welcome.robots) {
    const robot = element("div", "robot");
    const head = element("h3", "", `Node ${node}`);
    const badge = element("span", "badge", "-");
    const code = element("span", "code");
    head.append(badge, code);
    const list = element("dl");
    const rows = {};
    for (const [key, label] of [["scale", "can follow"], ["w0", "front left"], ["w1", "front right"], ["w2", "rear left"], ["w3", "rear right"]]) {
      const value = element("dd", "", "-");
      const meter = bar();
      const cell = element("dd", "wide");
      cell.append(meter);
      list.append(element("dt", "", label), cell, value);
      rows[key] = { value, meter };
    }
    const slip = element("dd", "", "-");
    list.append(element("dt", "", "slip"), element("dd", "wide"), slip);
    robot.append(head, list);
    robots[node] = { badge, code, rows, slip };
    $("robots").append(robot);
  }
}

function fill(meter, share, kind) {
  const inner = meter.firstChild;
  const size = Math.min(1, Math.abs(share));
  inner.style.width = `${(size * 100).toFixed(1)}%`;
  meter.className = `bar ${kind || ""}`;
}

// A bar that grows from its middle: to the right forward, to the left backward.
function fillSigned(meter, share) {
  const size = Math.min(1, Math.abs(share)) * 50;
  meter.firstChild.style.width = `${size.toFixed(1)}%`;
  meter.firstChild.style.left = `${share < 0 ? 50 - size : 50}%`;
}

const known = (value) => value !== null && value !== undefined;
const format = (value, digits, unit) => (known(value) ? `${value.toFixed(digits)} ${unit}`.trim() : "-");

function gauge(name, text, share, kind) {
  gauges[name].children[1].textContent = text;
  if (share !== undefined) fill(gauges[name].children[2], share || 0, kind);
}

function show() {
  const fresh = state && performance.now() - stateAt < STALE_MS;
  const open = backend !== null && backend.isOpen();
  const phase = !open ? "no connection" : fresh ? state.phase : "no data";
  const age = state ? performance.now() - stateAt : 0;
  const foreign = fresh && state.foreign;
  document.body.classList.toggle("old", age > OLD_MS);
  $("phase").textContent = foreign ? "another master drives" : age > OLD_MS ? `${phase}, ${(age / 1000).toFixed(1)} s old` : phase;
  $("phase").className = `badge ${foreign ? "starting" : fresh && open ? state.phase : "lost"}`;
  $("token-form").hidden = trusted || !welcome || !welcome.can_drive;
  $("controls").hidden = !trusted || !welcome || !welcome.can_drive;
  const may = fresh && seat.yours;
  $("take").textContent = seat.yours ? "Give up controls" : seat.taken ? "Another page drives" : "Take the controls";
  $("take").disabled = seat.taken && !seat.yours;
  $("start").disabled = !may || phase !== "idle";
  $("start").textContent = phase === "starting" ? "Starting..." : phase === "running" ? "Started" : "Start robots";
  for (const pad of [$("move"), $("turn")]) pad.classList.toggle("off", !ready());
  $("begin").disabled = !ready() && !course;
  $("begin").textContent = course ? "End curve" : "Drive curve";
  if (welcome && !welcome.can_drive) say("This page watches; it was started with --watch.", true);
  if (!welcome) return;
  const share = $("speed").value / 100;
  $("speed-text").textContent = `${(welcome.linear_speed * share).toFixed(2)} m/s, ${(welcome.yaw_rate * share).toFixed(2)} rad/s`;
  if (!state) return;
  const speed = state.measured ? Math.hypot(state.measured[0], state.measured[1]) : null;
  gauge("speed", format(speed, 2, "m/s"), speed / welcome.linear_speed);
  const yaw = state.measured ? state.measured[2] : null;
  gauge("yaw", format(yaw, 2, "rad/s"), Math.abs(yaw) / welcome.yaw_rate);
  gauge("scale", known(state.scale) ? `${(state.scale * 100).toFixed(0)} %` : "-", state.scale, state.scale < 0.999 ? "warn" : "");
  gauge("strain", known(state.strain) ? format(state.strain * 1000, 1, "mm/s") : "-");
  const slips = state.robots.map((robot) => robot.slip).filter(known).map(Math.abs);
  gauge("slip", slips.length ? format(Math.max(...slips), 2, "rad/s") : "-");
  gauge("load", known(state.bus_load) ? format(state.bus_load * 100, 1, "%") : "-", state.bus_load, state.bus_load > 0.7 ? "warn" : "");
  for (const robot of state.robots) showRobot(robot);
  const pose = state.pose;
  $("place").textContent = pose ? `x ${pose[0].toFixed(3)} m  y ${pose[1].toFixed(3)} m  heading ${(pose[2] * 180 / Math.PI).toFixed(1)}\u00b0` : "";
}

// NMT states in words; a started robot says its own state.
const NMT = { Operational: "started, no status", PreOperational: "not started", Stopped: "stopped", Initialising: "booting" };

function showRobot(robot) {
  const cell = robots[robot.node];
  const data = welcome.robots.find((one) => one.node === robot.node);
  if (!cell || !data) return;
  cell.badge.textContent = robot.state || NMT[robot.nmt] || "silent";
  const good = robot.state === "Armed" || robot.state === "Moving";
  cell.badge.className = `badge ${robot.state === "Faulted" ? "lost" : good ? "running" : robot.state === "Ramping" ? "stopping" : ""}`;
  cell.code.textContent = robot.code || (robot.past ? `last: ${robot.past}` : "");
  cell.code.className = `code ${robot.code ? robot.kind : "past"}`;
  cell.rows.scale.value.textContent = known(robot.scale) ? `${(robot.scale * 100).toFixed(0)} %` : "-";
  fill(cell.rows.scale.meter, robot.scale || 0, robot.scale < 0.999 ? "warn" : "");
  for (let wheel = 0; wheel < 4; wheel += 1) {
    const rate = robot.wheels ? robot.wheels[wheel] : null;
    cell.rows[`w${wheel}`].value.textContent = format(rate, 2, "rad/s");
    fillSigned(cell.rows[`w${wheel}`].meter, (rate || 0) / data.max_wheel_rate);
  }
  cell.slip.textContent = format(robot.slip, 2, "rad/s");
}

// ---- map --------------------------------------------------------------------------------------------------

let centre = null;
let drawn = false;
// How near the map is, and the scale it was drawn with, px/m; moved by hand it does not follow the group.
const look = { near: 1, scale: 1, moved: false };
const NEAREST = 8;
// Where the group was last seen: robots that are not started do not say.
let here = [0, 0, 0];

// ---- plot -------------------------------------------------------------------------------------------------

let samples = [];
// What the plot shows: so many seconds, of which the last was so many seconds ago.
const view = { seconds: PLOT_S, ago: 0 };

function remember() {
  const size = (twist) => (twist ? Math.hypot(twist[0], twist[1]) : null);
  samples.push([performance.now(), size(state.command), size(state.measured)]);
  const from = performance.now() - PLOT_LONGEST_S * 1000;
  if (samples.length > 2 && samples[1][0] < from) samples.shift();
  keep();
}

// Zooms the plot by a factor; what is at this share of its width, from the right, stays there.
function stretch(factor, share) {
  const fixed = view.ago + share * view.seconds;
  view.seconds = Math.min(PLOT_LONGEST_S, Math.max(PLOT_SHORTEST_S, view.seconds * factor));
  shift(fixed - share * view.seconds - view.ago);
}

function shift(seconds) {
  view.ago = Math.min(PLOT_LONGEST_S - view.seconds, Math.max(0, view.ago + seconds));
  plot();
}

function span(seconds) {
  if (seconds === PLOT_S) return "minute";
  return seconds < 100 ? `${seconds.toFixed(0)} s` : `${(seconds / 60).toFixed(1)} min`;
}

function browse() {
  const canvas = $("plot");
  let from = null;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    stretch(Math.exp(event.deltaY / 400), (box.right - event.clientX) / box.width);
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    from = event.clientX;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (from === null) return;
    shift((event.clientX - from) / canvas.clientWidth * view.seconds);
    from = event.clientX;
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { from = null; });
  canvas.addEventListener("dblclick", () => {
    Object.assign(view, { seconds: PLOT_S, ago: 0 });
    plot();
  });
  $("shorter").addEventListener("click", () => stretch(0.5, 0));
  $("longer").addEventListener("click", () => stretch(2, 0));
}

function plot() {
  const canvas = $("plot");
  const zoom = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * zoom);
  canvas.height = Math.round(height * zoom);
  const paint = canvas.getContext("2d");
  paint.setTransform(zoom, 0, 0, zoom, 0, 0);
  paint.fillStyle = css("--page");
  paint.fillRect(0, 0, width, height);
  $("plot-title").textContent = `Speed, ${view.ago ? "" : "last "}${span(view.seconds)}${view.ago ? `, until ${span(view.ago)} ago` : ""}`;
  const last = performance.now() - view.ago * 1000;
  // One more on both sides, so that lines run to the edges.
  const first = samples.findIndex((s) => s[0] > last - view.seconds * 1000);
  const after = samples.findIndex((s) => s[0] > last);
  const shown = first < 0 ? [] : samples.slice(Math.max(0, first - 1), after < 0 ? undefined : after + 1);
  const most = shown.reduce((largest, s) => Math.max(largest, s[1] || 0, s[2] || 0), 0.1) * 1.1;
  const at = (t, value) => [width - (last - t) / 1000 / view.seconds * width, height - 16 - value / most * (height - 26)];
  paint.strokeStyle = css("--line");
  paint.fillStyle = css("--quiet");
  paint.font = "11px system-ui, sans-serif";
  const step = [1, 2, 5, 10, 30, 60, 120].find((one) => view.seconds / one <= 7) || 120;
  for (let s = Math.ceil(view.ago / step) * step; s <= view.ago + view.seconds; s += step) {
    const x = Math.round(width - (s - view.ago) / view.seconds * width) + 0.5;
    paint.beginPath(); paint.moveTo(x, 0); paint.lineTo(x, height - 16); paint.stroke();
    if (s && x > 8) paint.fillText(step < 60 ? `-${s} s` : `-${s / 60} min`, x + 2, height - 4);
  }
  paint.fillText(`${(most / 1.1).toFixed(2)} m/s`, 4, 12);
  for (const [column, colour, dashes] of [[1, "--orange", [6, 4]], [2, "--blue", []]]) {
    paint.strokeStyle = css(colour);
    paint.lineWidth = 2;
    paint.setLineDash(dashes);
    paint.beginPath();
    let drawing = false;
    for (const sample of shown) {
      if (!known(sample[column])) { drawing = false; continue; }
      const [x, y] = at(sample[0], sample[column]);
      if (drawing) paint.lineTo(x, y); else paint.moveTo(x, y);
      drawing = true;
    }
    paint.stroke();
  }
  paint.setLineDash([]);
}

function lengthen(path, x, y) {
  const last = path[path.length - 1];
  if (!last || Math.hypot(x - last[0], y - last[1]) > TRAIL_M) path.push([x, y]);
  if (path.length > TRAIL_POINTS) path.shift();
}

function follow() {
  if (state.curve && state.target) {
    if (aims.length && state.curve[0] < aims.t) aims = [];
    aims.t = state.curve[0];
    lengthen(aims, state.target[0], state.target[1]);
  }
  if (state.pose) {
    here = state.pose;
    const [x, y] = here;
    lengthen(trail, x, y);
  }
  if (!centre) centre = [here[0], here[1]];
  if (!drawn) {
    drawn = true;
    requestAnimationFrame(draw);
  }
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function compose(frame, x, y) {
  const [sin, cos] = [Math.sin(frame[2]), Math.cos(frame[2])];
  return [frame[0] + cos * x - sin * y, frame[1] + sin * x + cos * y];
}

function draw() {
  drawn = false;
  const canvas = $("map");
  const zoom = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * zoom) || canvas.height !== Math.round(height * zoom)) {
    canvas.width = Math.round(width * zoom);
    canvas.height = Math.round(height * zoom);
  }
  const paint = canvas.getContext("2d");
  paint.setTransform(zoom, 0, 0, zoom, 0, 0);
  paint.fillStyle = css("--page");
  paint.fillRect(0, 0, width, height);
  const pose = here;
  if (!state || !welcome || !centre) return;
  const reach = Math.max(1.2, ...welcome.robots.map((r) => Math.hypot(r.mount[0], r.mount[1]) + 0.8));
  const scale = (Math.min(width, height) / (4 * reach)) * look.near;
  look.scale = scale;
  if (!look.moved) {
    // The map stands still until the group nears its edge.
    const spare = (size) => Math.max(0, size / scale / 2 - reach * 0.9);
    const [room, side] = [spare(height), spare(width)];
    centre[0] = Math.min(pose[0] + room, Math.max(pose[0] - room, centre[0]));
    centre[1] = Math.min(pose[1] + side, Math.max(pose[1] - side, centre[1]));
  }
  // Forward is up, left is left.
  const at = ([x, y]) => [width / 2 - (y - centre[1]) * scale, height / 2 - (x - centre[0]) * scale];
  grid(paint, width, height, scale);
  const path = (points, close) => {
    paint.beginPath();
    points.forEach((point, n) => { const [a, b] = at(point); if (n) paint.lineTo(a, b); else paint.moveTo(a, b); });
    if (close) paint.closePath();
  };
  paint.lineJoin = "round";
  paint.strokeStyle = css("--blue");
  paint.globalAlpha = 0.55;
  paint.lineWidth = 2;
  path([...trail, pose]);
  paint.stroke();
  paint.strokeStyle = css("--green");
  paint.setLineDash([7, 5]);
  path(aims);
  paint.stroke();
  paint.setLineDash([]);
  paint.globalAlpha = 1;
  if (state.target) group(paint, path, state.target, true);
  group(paint, path, pose, false, at);
  const seconds = 1.5; // an arrow is where the velocity leads in this time
  const arrow = (twist, colour, wide) => {
    if (!twist || Math.hypot(twist[0], twist[1]) * seconds * scale < 4) return;
    const [from, to] = [at(pose), at(compose(pose, twist[0] * seconds, twist[1] * seconds))];
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    paint.strokeStyle = colour;
    paint.fillStyle = colour;
    paint.lineWidth = wide;
    paint.beginPath();
    paint.moveTo(...from);
    paint.lineTo(...to);
    paint.stroke();
    paint.beginPath();
    paint.moveTo(to[0] + Math.cos(angle) * 9, to[1] + Math.sin(angle) * 9);
    paint.lineTo(to[0] + Math.cos(angle + 2.5) * 8, to[1] + Math.sin(angle + 2.5) * 8);
    paint.lineTo(to[0] + Math.cos(angle - 2.5) * 8, to[1] + Math.sin(angle - 2.5) * 8);
    paint.fill();
  };
  arrow(state.command, css("--orange"), 6);
  arrow(state.measured, css("--blue"), 3);
}

function grid(paint, width, height, scale) {
  const step = scale > 440 ? 0.1 : scale > 110 ? 0.5 : scale > 25 ? 1 : 5;
  paint.strokeStyle = css("--line");
  paint.fillStyle = css("--quiet");
  paint.font = "11px system-ui, sans-serif";
  paint.lineWidth = 1;
  const x0 = centre[0] - height / scale / 2;
  const y0 = centre[1] - width / scale / 2;
  const label = (value) => `${Number(value.toFixed(1))} m`;
  for (let x = Math.ceil(x0 / step) * step; x < x0 + height / scale; x += step) {
    const b = Math.round(height / 2 - (x - centre[0]) * scale) + 0.5;
    paint.beginPath(); paint.moveTo(0, b); paint.lineTo(width, b); paint.stroke();
    if (b > 14 && b < height - 18) paint.fillText(label(x), 4, b - 3);
  }
  for (let y = Math.ceil(y0 / step) * step; y < y0 + width / scale; y += step) {
    const a = Math.round(width / 2 - (y - centre[1]) * scale) + 0.5;
    paint.beginPath(); paint.moveTo(a, 0); paint.lineTo(a, height); paint.stroke();
    if (a > 50 && a < width - 36) paint.fillText(label(y), a + 3, height - 5);
  }
}

// By mouse; a finger on the map scrolls the page.
function navigate() {
  const canvas = $("map");
  let from = null;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const near = look.near * Math.exp(-event.deltaY / 400);
    look.near = Math.min(NEAREST, Math.max(1 / NEAREST, near));
    draw();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    from = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from || !centre) return;
    centre[0] += (event.clientY - from[1]) / look.scale;
    centre[1] += (event.clientX - from[0]) / look.scale;
    from = [event.clientX, event.clientY];
    look.moved = true;
    draw();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { from = null; });
  canvas.addEventListener("dblclick", () => {
    Object.assign(look, { near: 1, moved: false });
    draw();
  });
}
navigate();
browse();

// The load between the robots, and the robots; only outlines for the target.
function group(paint, path, pose, ghost, at) {
  const mounts = welcome.robots.map((robot) => {
    const [x, y] = compose(pose, robot.mount[0], robot.mount[1]);
    return [x, y, pose[2] + robot.mount[2]];
  });
  if (!ghost) {
    paint.strokeStyle = css("--quiet");
    paint.globalAlpha = 0.35;
    paint.lineWidth = 14;
    paint.lineCap = "round";
    path(mounts, mounts.length > 2);
    paint.stroke();
    paint.globalAlpha = 1;
    paint.lineCap = "butt";
  }
  welcome.robots.forEach((robot, n) => {
    const [l, w] = [robot.half_wheelbase, robot.half_track];
    path([[l, w], [l, -w], [-l, -w], [-l, w]].map(([x, y]) => compose(mounts[n], x, y)), true);
    const now = state.robots.find((one) => one.node === robot.node) || {};
    if (ghost) {
      paint.setLineDash([5, 5]);
      paint.strokeStyle = css("--green");
      paint.lineWidth = 2;
      paint.stroke();
      paint.setLineDash([]);
      return;
    }
    paint.fillStyle = css("--robot");
    paint.fill();
    paint.strokeStyle = css(now.kind === "fault" ? "--red" : now.kind === "limit" ? "--orange" : "--blue");
    paint.lineWidth = 2;
    paint.stroke();
    // Wheels, and a tick at the front.
    paint.strokeStyle = css("--ink");
    paint.lineWidth = 4;
    for (const [x, y] of [[l, w], [l, -w], [-l, w], [-l, -w]]) {
      path([compose(mounts[n], x - robot.wheel_radius * 0.8, y), compose(mounts[n], x + robot.wheel_radius * 0.8, y)]);
      paint.stroke();
    }
    paint.lineWidth = 2;
    path([[l, 0.08], [l + 0.12, 0], [l, -0.08]].map(([x, y]) => compose(mounts[n], x, y)));
    paint.stroke();
    const [a, b] = at(mounts[n]);
    paint.fillStyle = css("--ink");
    paint.font = "600 13px system-ui, sans-serif";
    paint.textAlign = "center";
    paint.fillText(String(robot.node), a, b + 5);
    paint.textAlign = "start";
  });
}

// ---- the dead-man's press ----------------------------------------------------------------------------------

const held = { move: null, turn: null, keys: new Set() };
let press = 0;
let timer = null;

const ready = () => Boolean(trusted && seat.yours && state && state.phase === "running" && performance.now() - stateAt < STALE_MS);

// Those of `omnibus teleop`, where s starts and q quits.
const KEYS = {
  ArrowUp: [1, 0, 0], KeyI: [1, 0, 0], ArrowDown: [-1, 0, 0], KeyK: [-1, 0, 0],
  ArrowLeft: [0, 1, 0], KeyJ: [0, 1, 0], ArrowRight: [0, -1, 0], KeyL: [0, -1, 0],
  KeyU: [0, 0, 1], KeyO: [0, 0, -1],
};

function deflection() {
  let [x, y, turn] = [0, 0, 0];
  if (held.move) [x, y] = held.move;
  if (held.turn !== null) turn = held.turn;
  for (const key of held.keys) {
    x += KEYS[key][0];
    y += KEYS[key][1];
    turn += KEYS[key][2];
  }
  const length = Math.max(1, Math.hypot(x, y));
  return [x / length, y / length, Math.max(-1, Math.min(1, turn))];
}

const anything = () => held.move !== null || held.turn !== null || held.keys.size > 0;

// ---- curves -------------------------------------------------------------------------------------------------

// The curve that is being asked for: a press that this page repeats, until something else is done.
let course = null;

function drive_curve() {
  if (course) {
    release();
    return;
  }
  const scale = $("scale").valueAsNumber;
  if (!ready()) {
    say(seat.yours ? "Start the robots first." : "Take the controls first.", true);
  } else if (!Number.isFinite(scale)) {
    say("The scale is a number: 0.2 makes the curve a fifth as large.");
  } else {
    release();
    press += 1;
    course = { name: $("curve").value, scale, at: null };
    say("");
    timer = setInterval(repeat, SEND_MS);
    repeat();
  }
}

// What the robots have driven of it, as the server says.
function progress() {
  if (!course) return;
  if (state.curve) {
    course.at = state.curve;
    say(`${course.name}: ${state.curve[0].toFixed(0)} of ${state.curve[1].toFixed(0)} s`, true);
  } else if (course.at) {
    const { name } = course;
    release();
    say(`${name}: done`, true);
  }
}

function pressed() {
  if (course) {
    release();
    return;
  }
  if (!ready()) {
    let_go();
    if (trusted && !seat.yours) say("Take the controls first.", true);
    else if (trusted) say("Start the robots first.", true);
    return;
  }
  if (timer === null) {
    press += 1;
    say("");
    timer = setInterval(repeat, SEND_MS);
  }
  repeat();
}

function repeat() {
  if (!ready()) {
    release();
    return;
  }
  if (course) {
    send({ type: "curve", press, curve: course.name, scale: course.scale, clock: state.clock });
    return;
  }
  const share = $("speed").value / 100;
  const [x, y, turn] = deflection();
  send({ type: "drive", press, vx: x * share * welcome.linear_speed, vy: y * share * welcome.linear_speed,
    omega: turn * share * welcome.yaw_rate, clock: state.clock });
}

function let_go() {
  held.move = null;
  held.turn = null;
  held.keys.clear();
  for (const pad of [$("move"), $("turn")]) {
    pad.classList.remove("held");
    pad.lastElementChild.style.transform = "";
  }
}

function release() {
  let_go();
  if (course && course.at) say(`${course.name}: ended after ${course.at[0].toFixed(1)} of ${course.at[1].toFixed(1)} s`, true);
  course = null;
  if (timer !== null) {
    clearInterval(timer);
    timer = null;
    send({ type: "release" });
  }
}

function pad(id, flat) {
  const area = $(id);
  const take = (event) => {
    const box = area.getBoundingClientRect();
    const reach = box.width / 2 - 28;
    let x = (event.clientX - box.left - box.width / 2) / reach;
    let y = flat ? 0 : (event.clientY - box.top - box.height / 2) / reach;
    const length = Math.max(1, Math.hypot(x, y));
    [x, y] = [x / length, y / length];
    area.lastElementChild.style.transform = `translate(${x * reach}px, ${y * reach}px)`;
    if (flat) held.turn = -x; else held.move = [-y, -x];
  };
  area.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    area.focus();
    area.setPointerCapture(event.pointerId);
    area.classList.add("held");
    take(event);
    pressed();
  });
  area.addEventListener("pointermove", (event) => { if (area.hasPointerCapture(event.pointerId) && timer !== null) take(event); });
  const end = () => {
    if (flat) held.turn = null; else held.move = null;
    area.classList.remove("held");
    area.lastElementChild.style.transform = "";
    if (!anything()) release();
  };
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) area.addEventListener(name, end);
  area.addEventListener("contextmenu", (event) => event.preventDefault());
}

const takesKeys = (target) => target instanceof HTMLInputElement || target instanceof HTMLSelectElement;

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code === "Space" && event.target !== $("token")) {
    event.preventDefault();
    stop();
  } else if (event.code in KEYS && seat.yours && !takesKeys(event.target)) {
    event.preventDefault();
    if (event.repeat) return;
    held.keys.add(event.code);
    pressed();
  }
});
document.addEventListener("keyup", (event) => {
  // Space stops also where a button has the focus; Enter is left for the button.
  if (event.code === "Space" && event.target !== $("token")) event.preventDefault();
  if (held.keys.delete(event.code) && !anything()) release();
});
// A user who does not look at this page does not drive.
window.addEventListener("blur", release);
window.addEventListener("pagehide", release);
document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });

// ---- buttons ----------------------------------------------------------------------------------------------

function stop() {
  release();
  send({ type: "stop" });
}

$("stop").addEventListener("click", stop);
$("take").addEventListener("click", () => { release(); say(""); send({ type: seat.yours ? "leave" : "take" }); });
$("start").addEventListener("click", () => { say(""); send({ type: "start" }); });
$("begin").addEventListener("click", drive_curve);
$("speed").addEventListener("input", show);
$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  token = $("token").value.trim();
  $("token").value = "";
  sessionStorage.setItem("token", token);
  send({ type: "hello", token });
});
window.addEventListener("resize", () => { if (state) draw(); });
setInterval(show, 100);
setInterval(plot, 200);

pad("move", false);
pad("turn", true);
readToken();
connect();
