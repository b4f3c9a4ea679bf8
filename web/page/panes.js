// What the page shows beside the group when the group is in it: what the world is, its frames, one robot from inside,
// faults. And the first drive, which the page begins by itself: the figure-eight, until a hand does something.
"use strict";

const panes = (() => {
  const make = (kind, attributes = {}, ...children) => {
    const made = Object.assign(document.createElement(kind), attributes);
    made.append(...children);
    return made;
  };
  const find = (id) => document.getElementById(id);
  const FRAME_LINES = 24;
  const LOG_LINES = 60;
  const FAULTS = [
    ["Unplug an encoder", "encoder-dead:wheel=front-left", "encoder-works:wheel=front-left"],
    ["Cut the bus", "bus-cut", "bus-cut=off"],
    ["Press the emergency stop", "emergency-stop", "emergency-stop=off"],
    ["Driver reports a fault", "driver-fault", "driver-fault=off"],
    ["Switch it off and on", "power-cycle", null],
    ["Brake a wheel", "wheel-drag=20:wheel=front-left", "wheel-drag=0:wheel=front-left"],
  ];

  const select = (id, label, options, value, changed) => {
    const list = make("select", { id });
    for (const [name, title] of options) list.append(make("option", { value: name, textContent: title }));
    list.value = value;
    list.addEventListener("change", () => changed(list.value));
    return make("label", { className: "choice" }, make("span", { textContent: label }), list);
  };
  const check = (id, label, value, changed) => {
    const box = make("input", { id, type: "checkbox", checked: value });
    box.addEventListener("change", () => changed(box.checked));
    return make("label", { className: "choice" }, box, make("span", { textContent: label }));
  };
  const card = (id, title, ...children) => make("section", { id, className: "card" }, make("h2", { textContent: title }), ...children);

  let playing = true; // until a hand does something
  let looked = { node: 2, frames: false };
  const active = new Set();

  function reopen(name, value) {
    choice[name] = value;
    playing = true;
    active.clear();
    find("phases").disabled = choice.floor !== "contact";
    say("");
    openWorld().catch((error) => say(error.message));
  }

  function say(text) {
    // Before there is a world, in the place of the page's own messages.
    (find("world-says") || find("message")).textContent = text;
  }

  function groups(list) {
    const robots = [["automatic", "as this machine allows"], ["native", "native"], ["emulated", "emulated, release image"]];
    const row = make("div", { className: "choices" },
      select("choose-group", "Group", list, choice.group, (value) => reopen("group", value)),
      select("choose-floor", "Floor", [["table", "the paper's tables"], ["contact", "rollers in contact"]], choice.floor, (value) => reopen("floor", value)),
      select("choose-robots", "Robots", robots, choice.robots, (value) => reopen("robots", value)),
      check("compensation", "compensation", choice.compensation, (value) => reopen("compensation", value)),
      check("phases", "roller phases known", choice.phases, (value) => reopen("phases", value)));
    const says = make("p", { id: "world-says", className: "quiet" });
    says.setAttribute("role", "status");
    const book = make("p", { className: "quiet" }, "Everything here is simulated, in this page alone: nothing is sent anywhere. ",
      make("a", { href: "docs/README.html", textContent: "The documents" }), " explain it.",
      location.protocol === "file:" ? " This page was opened as a file: all of it works where the browser starts workers from files." : "");
    document.querySelector("main").prepend(card("world-card", "World in this page", row, says, make("p", { id: "pace", className: "quiet numbers" }), book));
    find("phases").disabled = choice.floor !== "contact";
    document.querySelector("main").append(card("faults-card", "Faults", make("p", { className: "row wrap", id: "faults" })),
      card("inside-card", "Inside one robot", make("p", { id: "inside-node", className: "row wrap" }), make("div", { id: "inside" }), make("ol", { id: "inside-log", className: "lines" })),
      card("frames-card", "CAN frames", check("look-frames", "show them as they pass", false, (value) => look({ frames: value })), make("ol", { id: "frames", className: "lines" })));
  }

  function look(change) {
    looked = { ...looked, ...change };
    post("look", looked);
  }

  function opened({ robots, speed }) {
    const times = speed === null ? "" : ` This machine would drive the emulated group at ${speed.toFixed(1)} times real time.`;
    const kinds = { native: "Native robots: the robot's own crate, compiled for the browser.", emulated: "Emulated robots: each runs the release image, unmodified." };
    find("world-says").textContent = kinds[robots] + times;
    find("frames").replaceChildren();
    find("inside-log").replaceChildren();
    look({});
  }

  function robotButtons() {
    const nodes = welcome.robots.map((robot) => robot.node);
    if (find("inside-node").dataset.nodes === nodes.join()) return;
    find("inside-node").dataset.nodes = nodes.join();
    if (!nodes.includes(looked.node)) look({ node: nodes[0] });
    const chosen = make("select", { id: "look-node" });
    for (const node of nodes) chosen.append(make("option", { value: node, textContent: `node ${node}` }));
    chosen.value = looked.node;
    chosen.addEventListener("change", () => { find("inside-log").replaceChildren(); active.clear(); faults(); look({ node: Number(chosen.value) }); });
    find("inside-node").replaceChildren(chosen);
    faults();
  }

  function faults() {
    find("faults").replaceChildren(...FAULTS.map(([title, begin, end]) => {
      const button = make("button", { type: "button", textContent: title });
      button.addEventListener("click", () => {
        playing = false;
        const ends = active.delete(title);
        post("inject", `node=${looked.node}:${ends ? end : begin}`);
        if (!ends && end) active.add(title);
        button.textContent = active.has(title) ? `${title}: undo` : title;
        button.classList.toggle("danger", active.has(title));
      });
      return button;
    }), make("span", { className: "quiet", textContent: "at the robot chosen below; what the group does then is among the events." }));
  }

  const percent = (duty) => `${(duty * 100).toFixed(1)} %`;
  const hex = (value) => (value >>> 0).toString(16).padStart(8, "0");

  function inside(robot) {
    const wheels = ["front left", "front right", "rear left", "rear right"];
    const rows = wheels.map((wheel, n) => [wheel, `duty ${percent(robot.duties[n])}`, `${robot.rates[n].toFixed(2)} rad/s`]);
    for (const [name, duty, period, on] of robot.pwm || []) {
      rows.push([name, on ? `duty ${percent(duty)}` : "off", period ? `${(1e6 / period).toFixed(1)} kHz` : "stands"]);
    }
    const table = make("table", {}, ...rows.map((row) => make("tr", {}, ...row.map((text) => make("td", { textContent: text })))));
    const core = robot.registers ? [...robot.registers.map((value, n) => `${["sp", "lr", "pc"][n - 13] || `r${n}`} ${hex(value)}`), `xpsr ${hex(robot.xpsr)}`, `${(robot.instructions / 1e6).toFixed(1)} million instructions`].join("  ")
      : "Native robots have no registers; choose emulated ones to see them.";
    find("inside").replaceChildren(table, make("p", { className: "quiet mono", textContent: core }));
    for (const [t, level, text] of robot.log) find("inside-log").prepend(make("li", { className: level, textContent: `${t.toFixed(6)} ${level} ${text}` }));
    while (find("inside-log").children.length > LOG_LINES) find("inside-log").lastChild.remove();
  }

  function frames({ lines }) {
    const shown = lines.slice(-FRAME_LINES).map(([t, id, bytes, name, meaning]) =>
      make("li", { textContent: `${t.toFixed(4)}  ${id}  ${bytes.padEnd(23)}  ${name}${meaning ? `: ${meaning}` : ""}` }));
    if (shown.length) find("frames").replaceChildren(...shown);
  }

  function news({ pace, robot, frames: passed, now }) {
    if (!welcome) return;
    robotButtons();
    find("pace").textContent = `${(now / 1000).toFixed(1)} s of its time${pace ? `, at ${pace.toFixed(2)} times real time` : ""}`;
    if (robot) inside(robot);
    if (passed) frames(passed);
    play();
  }

  // The first drive. A press of the stick, a key or a button is a hand.
  function play() {
    if (!playing || !state || !trusted || find("controls").hidden) return;
    if (!seat.yours) send({ type: "take" });
    else if (state.phase === "idle" && !find("start").disabled) find("start").click();
    else if (state.phase === "running" && course === null && ready()) {
      find("curve").value = "figure-eight";
      find("scale").value = "0.6";
      find("begin").click();
    }
  }
  for (const kind of ["pointerdown", "keydown"]) {
    document.addEventListener(kind, (event) => { if (event.isTrusted && event.target.closest("#drive-card, #stop")) playing = false; }, true);
  }
  document.addEventListener("keydown", (event) => { if (event.isTrusted && (event.code === "Space" || event.code in KEYS)) playing = false; }, true);

  return { groups, opened, news, say, stopPlaying: () => { playing = false; } };
})();
