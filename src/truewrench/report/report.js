"use strict";
(async () => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  await Bokeh.embed.embed_items(read("documents"), read("places"));
  const views = Object.values(Bokeh.index.roots ?? Bokeh.index);
  const time = Bokeh.documents[0].get_model_by_name("time");

  // a finger scrolls the page, a mouse zooms
  if (matchMedia("(pointer: fine)").matches) {
    for (const figure of Bokeh.documents[0].roots())
      for (const tool of figure.toolbar.tools) tool.active = true;
  }

  const repaint = () => {
    for (const view of views) view.request_repaint();
  };
  for (const query of ["(prefers-color-scheme: dark)", "print"])
    matchMedia(query).addEventListener("change", repaint);

  const controls = document.querySelector(".controls");
  if (!controls || !time) return;
  controls.hidden = false;
  const whole = [time.start, time.end];
  const shown = controls.querySelector("output");
  const tell = () => {
    shown.textContent = `${time.start.toPrecision(4)} to ${time.end.toPrecision(4)} s`;
  };
  time.change.connect(tell);
  tell();
  const moves = {
    in: (middle, half) => [middle - half / 2, middle + half / 2],
    out: (middle, half) => [middle - half * 2, middle + half * 2],
    earlier: (middle, half) => [middle - 2 * half, middle],
    later: (middle, half) => [middle, middle + 2 * half],
    all: () => whole,
  };
  controls.addEventListener("click", (event) => {
    const move = moves[event.target.dataset.zoom];
    if (!move) return;
    const half = (time.end - time.start) / 2;
    let [start, end] = move(time.start + half, half);
    const length = Math.min(end - start, whole[1] - whole[0]);
    start = Math.min(Math.max(start, whole[0]), whole[1] - length);
    time.setv({start, end: start + length});
  });
})();
