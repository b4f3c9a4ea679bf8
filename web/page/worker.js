// The worker: the group's world as WebAssembly, kept at the pace of the clock on the wall. `backend.js` starts it from
// this function's text, because browsers start no worker from a file that was opened without a server.
"use strict";

function omnibusWorker() {
  const SLICE_MS = 10; // virtual time of one step, a period of SYNC
  const NEWS_MS = 40; // how often the page is told
  const AHEAD_MS = 200; // further off the clock on the wall than this, the world starts counting anew
  const BUSY_MS = 30; // the longest without a look at what the page says
  const MEASURE_MS = 300; // virtual time over which this machine is measured
  const DRIVING = 4.2e6; // instructions a second of a driving robot (cargo xtask bench)
  const RESERVE = 1.25; // how much faster than real time an emulated group must be

  const encoder = new TextEncoder();
  const decoder = new TextDecoder();
  let wasm = null;
  let failure = "";
  let anchor = null; // time on the wall, less virtual time
  let pace = { from: 0, virtual: 0, factor: 1 };
  let running = false;

  const unzip = (bytes) => new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();

  function place(bytes) {
    const at = wasm.omnibus_allocate(bytes.length);
    new Uint8Array(wasm.memory.buffer, at, bytes.length).set(bytes);
    return at;
  }

  function call(request) {
    const bytes = encoder.encode(JSON.stringify(request));
    const at = wasm.omnibus_call(place(bytes), bytes.length);
    const answer = JSON.parse(decoder.decode(new Uint8Array(wasm.memory.buffer, at, wasm.omnibus_answer_length())));
    if ("failed" in answer) throw new Error(answer.failed);
    return answer.done;
  }

  async function load(module) {
    const compiled = await WebAssembly.compile(await unzip(module));
    const imports = {};
    for (const { module: from, name } of WebAssembly.Module.imports(compiled)) {
      imports[from] ??= {};
      // Libraries that could ask a browser for the date bring imports of their own; nothing here calls them.
      imports[from][name] = () => { throw new Error(`${name} is not there`); };
    }
    imports.omnibus = { omnibus_failed: (at, length) => { failure = decoder.decode(new Uint8Array(wasm.memory.buffer, at, length)); } };
    wasm = (await WebAssembly.instantiate(compiled, imports)).exports;
    wasm.omnibus_begin();
  }

  // How much faster than real time this machine would drive the emulated group.
  function measure(choice) {
    call({ open: { ...choice, robots: "emulated" } });
    const robots = call({ news: {} }).messages.find((message) => message.type === "welcome").robots.length;
    const before = call({ news: {} }).instructions;
    const from = performance.now();
    wasm.omnibus_advance(MEASURE_MS);
    const seconds = (performance.now() - from) / 1000;
    return (call({ news: {} }).instructions - before) / seconds / (DRIVING * robots);
  }

  function open(choice) {
    let speed = null;
    let robots = choice.robots;
    if (robots !== "native") speed = measure(choice);
    if (robots === "automatic") robots = speed > RESERVE ? "emulated" : "native";
    call({ open: { ...choice, robots } });
    anchor = null;
    pace = { from: performance.now(), virtual: 0, factor: null };
    postMessage({ opened: { robots, speed } });
    if (!running) tick();
    running = true;
  }

  // As much of the world as there is time for, then whatever the page has said meanwhile.
  function tick() {
    try {
      let now = wasm.omnibus_advance(0);
      const begin = performance.now();
      const lag = anchor === null ? Infinity : begin - anchor - now;
      if (Math.abs(lag) > AHEAD_MS) anchor = begin - now;
      while (now < performance.now() - anchor && performance.now() - begin < BUSY_MS) now = wasm.omnibus_advance(now + SLICE_MS);
    } catch (error) {
      fail(error);
      return;
    }
    setTimeout(tick, 4);
  }

  function tell() {
    if (!running) return;
    const news = call({ news: {} });
    const passed = performance.now() - pace.from;
    if (passed > 1000) pace = { from: performance.now(), virtual: news.now, factor: (news.now - pace.virtual) / passed };
    postMessage({ news: { ...news, pace: pace.factor } });
  }

  function fail(error) {
    running = false;
    postMessage({ failed: failure || error.message });
  }

  const takes = {
    load: async ({ module }) => { await load(module); postMessage({ groups: call({ groups: {} }) }); },
    image: async ({ bytes }) => {
      const image = new Uint8Array(await unzip(bytes));
      if (!wasm.omnibus_image(place(image), image.length)) throw new Error("the firmware's image is damaged");
    },
    open,
    say: (message) => call({ say: JSON.stringify(message) }),
    inject: (text) => call({ inject: text }),
    look: (what) => call({ look: what }),
    scenario: (choice) => postMessage({ scenario: call({ scenario: choice }) }),
  };
  // One message after the other, though some wait for the browser.
  let last = Promise.resolve();
  onmessage = ({ data: [kind, content] }) => {
    last = last.then(() => takes[kind](content)).catch((error) => {
      if (failure || error instanceof WebAssembly.RuntimeError) fail(error);
      else postMessage({ refused: error.message });
    });
  };
  setInterval(() => { try { tell(); } catch (error) { fail(error); } }, NEWS_MS);
}
