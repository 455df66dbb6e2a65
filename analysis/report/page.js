"use strict";
// Figures can be zoomed: Ctrl + wheel or + and −, dragging when enlarged, double click or 0 to reset.
// Folded sections are unfolded for printing.
(function () {
  for (const figure of document.querySelectorAll("figure")) {
    const svg = figure.querySelector("svg");
    if (!svg) continue;
    const whole = svg.viewBox.baseVal;
    const all = { x: whole.x, y: whole.y, w: whole.width, h: whole.height };
    let view = { ...all };
    let from = null;

    function show() {
      svg.setAttribute("viewBox", [view.x, view.y, view.w, view.h].join(" "));
      figure.classList.toggle("closer", view.w < 0.999 * all.w);
    }
    function place(event) {
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      return { x: at.x, y: at.y };
    }
    function zoom(factor, at) {
      const w = Math.min(Math.max(view.w * factor, all.w / 50), all.w);
      const share = w / view.w;
      view = { x: at.x - (at.x - view.x) * share, y: at.y - (at.y - view.y) * share, w, h: view.h * share };
      move(0, 0);
    }
    function move(dx, dy) {
      view.x = Math.min(Math.max(view.x + dx, all.x), all.x + all.w - view.w);
      view.y = Math.min(Math.max(view.y + dy, all.y), all.y + all.h - view.h);
      show();
    }
    function reset() { view = { ...all }; show(); }
    function middle() { return { x: view.x + view.w / 2, y: view.y + view.h / 2 }; }

    svg.setAttribute("tabindex", "0");
    svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      zoom(Math.exp(Math.sign(event.deltaY) * 0.2), place(event));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => {
      if (view.w >= all.w) return;
      from = { x: event.clientX, y: event.clientY };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      if (!from) return;
      const scale = view.w / svg.clientWidth;
      move((from.x - event.clientX) * scale, (from.y - event.clientY) * scale);
      from = { x: event.clientX, y: event.clientY };
    });
    for (const kind of ["pointerup", "pointercancel"]) svg.addEventListener(kind, () => { from = null; });
    svg.addEventListener("dblclick", (event) => (view.w < 0.999 * all.w ? reset() : zoom(0.4, place(event))));
    svg.addEventListener("keydown", (event) => {
      const step = view.w / 10;
      const acts = {
        "+": () => zoom(0.7, middle()), "=": () => zoom(0.7, middle()), "-": () => zoom(1.4, middle()), "0": reset,
        ArrowLeft: () => move(-step, 0), ArrowRight: () => move(step, 0),
        ArrowUp: () => move(0, -step), ArrowDown: () => move(0, step),
      };
      if (!(event.key in acts) || (event.key.startsWith("Arrow") && view.w >= all.w)) return;
      event.preventDefault();
      acts[event.key]();
    });
  }
  const folded = [];
  addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll("details:not([open])")) { part.open = true; folded.push(part); }
  });
  addEventListener("afterprint", () => { for (const part of folded.splice(0)) part.open = false; });
})();
