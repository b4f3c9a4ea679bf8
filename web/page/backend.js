// The page's way to the group where there is no server: the group itself, in a worker (`worker.js`). What comes beside
// the messages of the page, `panes.js` shows.
"use strict";

// What is to be opened; the address says it: index.html#group=tcc-2&robots=native
const choice = { group: "tcc-3", floor: "table", compensation: true, phases: false, robots: "automatic" };
for (const [name, value] of new URLSearchParams(location.hash.slice(1))) {
  if (typeof choice[name] === "boolean") choice[name] = value !== "off";
  else if (name in choice) choice[name] = value;
}

const world = { worker: null, opened: false, chosen: null, image: false, scenario: null };

function bytesOf(base64) {
  return Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
}

// Loads a file by an element, which browsers do without a server, too; it calls `omnibusLoaded`.
function loadFile(name) {
  return new Promise((resolve, reject) => {
    window.omnibusLoaded = (base64) => resolve(bytesOf(base64));
    const script = document.createElement("script");
    script.src = name;
    script.onerror = () => reject(new Error(`${name} is missing: build the folder again with cargo xtask web`));
    document.head.append(script);
  });
}

function post(kind, content) {
  world.worker.postMessage([kind, content]);
}

// Opens a world of what is chosen; the one before it is gone.
async function openWorld() {
  world.opened = false;
  if (choice.robots !== "native" && !world.image) {
    world.image = true;
    post("image", { bytes: await loadFile("image.js") });
  }
  // What an earlier world left.
  sessionStorage.removeItem("trail");
  post("open", { ...choice });
}

// Drives a metre in a world of its own, and gives everything about it as text.
function scenario(chosen) {
  return new Promise((resolve) => {
    world.scenario = resolve;
    post("scenario", chosen);
  });
}

function openBackend({ opened, received, closed }) {
  const blob = new Blob([`"use strict";(${omnibusWorker})();`], { type: "text/javascript" });
  world.worker = new Worker(URL.createObjectURL(blob));
  const takes = {
    groups: panes.groups,
    opened: (what) => {
      closed();
      [here, centre] = [[0, 0, 0], null];
      world.opened = true;
      opened();
      panes.opened(what);
    },
    news: (news) => {
      if (!world.opened) return;
      news.messages.forEach(received);
      panes.news(news);
    },
    refused: (reason) => panes.say(reason),
    failed: (reason) => {
      world.opened = false;
      closed();
      panes.say(`The world has stopped: ${reason}. Load the page again.`);
    },
    scenario: (text) => world.scenario(text),
  };
  world.worker.onmessage = ({ data }) => { for (const [kind, content] of Object.entries(data)) takes[kind](content); };
  world.worker.onerror = (event) => takes.failed(event.message || "this browser starts no workers here");
  loadFile("module.js").then((module) => {
    post("load", { module });
    return openWorld();
  }).catch((error) => takes.failed(error.message));
  return { isOpen: () => world.opened, send: (message) => { if (world.opened) post("say", message); } };
}
