"use strict";
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const views = [];
  const times = [];  // the time axes: one per figure over time, kept alike
  let shown = null;

  const show = (start, end) => {
    shown = [start, end];
    for (const time of times)
      if (time.start !== start || time.end !== end) time.setv({start, end});
    tell();
  };

  const draw = async (element) => {
    const figure = figures[element.id];
    if (!figure) return;
    delete figures[element.id];
    const managers = await Bokeh.embed.embed_items(figure.documents, [figure.place]);
    for (const manager of managers) {
      for (const view of manager) {
        if (view.model.type !== "Figure") continue;  // its document's notifications
        views.push(view);
        // a finger scrolls the page, a mouse zooms
        if (matchMedia("(pointer: fine)").matches)
          for (const tool of view.model.toolbar.tools) tool.active = true;
        const time = view.model.x_range;
        if (time.name !== "time") continue;
        times.push(time);
        if (shown) time.setv({start: shown[0], end: shown[1]});
        time.change.connect(() => show(time.start, time.end));
      }
    }
  };

  // what comes into sight first, the rest when there is nothing else to do
  const plots = [...document.querySelectorAll(".plot")];
  const seen = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
    },
    {rootMargin: "400px"},
  );
  for (const plot of plots) seen.observe(plot);
  const rest = async () => {
    const plot = plots.shift();
    if (!plot) return;
    await draw(plot);
    setTimeout(rest);
  };
  addEventListener("load", () => setTimeout(rest));

  // colours follow the page's; on paper they have to be there at once
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const view of views) view.request_repaint();
  });
  const paint = (paper) => {
    document.documentElement.classList.toggle("paper", paper);
    for (const view of views) {
      view.invalidate_painters();
      view.paint();
    }
  };
  addEventListener("beforeprint", () => paint(true));
  addEventListener("afterprint", () => paint(false));

  const controls = document.querySelector(".controls");
  const told = controls?.querySelector("output");
  const tell = () => {
    if (told) told.textContent = `${shown[0].toPrecision(4)} to ${shown[1].toPrecision(4)} s`;
  };
  if (!controls) return;
  controls.hidden = false;
  const length = Number(controls.dataset.end);
  const moves = {
    in: (middle, half) => [middle - half / 2, middle + half / 2],
    out: (middle, half) => [middle - half * 2, middle + half * 2],
    earlier: (middle, half) => [middle - 2 * half, middle],
    later: (middle, half) => [middle, middle + 2 * half],
    all: () => [0, length],
  };
  show(0, length);
  controls.addEventListener("click", (event) => {
    const move = moves[event.target.dataset.zoom];
    if (!move) return;
    const half = (shown[1] - shown[0]) / 2;
    const [start, end] = move(shown[0] + half, half);
    const width = Math.min(end - start, length);
    const first = Math.min(Math.max(start, 0), length - width);
    show(first, first + width);
  });
})();
