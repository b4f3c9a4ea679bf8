// The page's connection to the group: the WebSocket of `omnibus serve`. The page uses the `backend.js` that lies beside
// it; `cargo xtask web` puts another one there, with the group in the browser itself.
"use strict";

const RETRY_MS = 1000; // a lost connection is tried again after this

// Calls `opened()`, `received(message)` for every message, and `closed()`; an open backend takes messages by `send`.
function openBackend({ opened, received, closed }) {
  let socket = null;
  const isOpen = () => socket !== null && socket.readyState === WebSocket.OPEN;
  const connect = () => {
    socket = new WebSocket(`ws://${location.host}/ws`);
    socket.onopen = opened;
    socket.onmessage = (event) => received(JSON.parse(event.data));
    socket.onclose = () => {
      socket = null;
      closed();
      setTimeout(connect, RETRY_MS);
    };
  };
  connect();
  return { isOpen, send: (message) => { if (isOpen()) socket.send(JSON.stringify(message)); } };
}
