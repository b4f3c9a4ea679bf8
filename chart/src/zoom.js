// Charts of a page are zoomed by dragging over them: a rectangle, or only sideways for a stretch of time. A double click
// shows the whole again. Without scripts the page shows the same charts.
"use strict";
for (const figure of document.querySelectorAll("figure[data-plot]")) {
  const svg = figure.querySelector("svg");
  const whole = svg.getAttribute("viewBox");
  // The plot in the picture's units, and what its axes show.
  const [left, right, top, bottom, x0, x1, y0, y1] = figure.dataset.plot.split(" ").map(Number);
  const ticks = figure.appendChild(document.createElement("div"));
  const box = figure.appendChild(document.createElement("div"));
  [ticks.className, box.className, box.hidden] = ["ticks", "box", true];
  let from = null;
  const view = () => svg.getAttribute("viewBox").split(" ").map(Number);
  const place = (event) => {
    const shown = svg.getBoundingClientRect();
    const [x, y, width, height] = view();
    const held = (value, low, high) => Math.min(high, Math.max(low, value));
    return [held(x + (event.clientX - shown.left) / shown.width * width, left, right),
      held(y + (event.clientY - shown.top) / shown.height * height, top, bottom)];
  };
  const label = (value, step, x, y) => {
    const text = ticks.appendChild(document.createElement("span"));
    text.textContent = value.toFixed(Math.min(6, Math.max(0, Math.ceil(-Math.log10(step)))));
    // Inside the picture: below it is the legend.
    const transform = y === 1 ? "translate(-50%, -100%)" : "translateY(-50%)";
    Object.assign(text.style, { left: `${x * 100}%`, top: `${y * 100}%`, transform });
  };
  // The picture's own labels are outside when it is zoomed.
  const relabel = () => {
    const [x, y, width, height] = view();
    const across = (share) => x0 + (x + share * width - left) / (right - left) * (x1 - x0);
    const down = (share) => y1 - (y + share * height - top) / (bottom - top) * (y1 - y0);
    for (let k = 1; k <= 5; k += 1) {
      label(across(k / 6), (across(1) - across(0)) / 60, k / 6, 1);
      label(down(k / 6), (down(0) - down(1)) / 60, 0, k / 6);
    }
  };
  const show = (box) => {
    svg.setAttribute("viewBox", box || whole);
    svg.setAttribute("preserveAspectRatio", box ? "none" : "xMidYMid");
    svg.classList.toggle("zoomed", Boolean(box));
    ticks.replaceChildren();
    const [outer, inner] = [figure.getBoundingClientRect(), svg.getBoundingClientRect()];
    Object.assign(ticks.style, { left: `${inner.left - outer.left}px`, top: `${inner.top - outer.top}px`,
      width: `${inner.width}px`, height: `${inner.height}px` });
    if (box) relabel();
  };
  svg.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    event.preventDefault();
    from = { event, at: place(event) };
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (!from) return;
    const outer = figure.getBoundingClientRect();
    const [a, b] = [from.event, event];
    box.hidden = false;
    Object.assign(box.style, { left: `${Math.min(a.clientX, b.clientX) - outer.left}px`, top: `${Math.min(a.clientY, b.clientY) - outer.top}px`,
      width: `${Math.abs(a.clientX - b.clientX)}px`, height: `${Math.abs(a.clientY - b.clientY)}px` });
  });
  svg.addEventListener("pointerup", (event) => {
    if (!from) return;
    const { event: began, at: [ax, ay] } = from;
    const [bx, by] = place(event);
    from = null;
    box.hidden = true;
    if (Math.abs(event.clientX - began.clientX) < 8) return;
    const flat = Math.abs(event.clientY - began.clientY) < 8;
    const [, y, , height] = svg.classList.contains("zoomed") ? view() : [0, top, 0, bottom - top];
    show([Math.min(ax, bx), flat ? y : Math.min(ay, by), Math.abs(ax - bx), flat ? height : Math.abs(ay - by)].join(" "));
  });
  svg.addEventListener("pointercancel", () => { from = null; box.hidden = true; });
  svg.addEventListener("dblclick", () => show(null));
}
