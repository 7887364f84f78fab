// A cross hair through all charts over time with the values under it, and dots where
// the vehicles are at that time in the view from above. The values are
// read from the lines that are drawn; without scripts the page lacks nothing else.
(() => {
  const charts = [...document.querySelectorAll("svg[data-time]")].map((svg) => {
    const numbers = (name) => (svg.dataset[name] || "").split(" ").map(Number);
    const lines = [...svg.querySelectorAll("path[data-name]")].map((path) => ({
      path,
      name: path.dataset.name,
      runs: path.getAttribute("d").split("M").slice(1)
        .map((run) => run.split("L").map((point) => point.split(" ").map(Number))),
    }));
    const cursor = svg.querySelector("path").cloneNode();
    cursor.setAttribute("class", "cursor");
    cursor.setAttribute("d", "");
    svg.append(cursor);
    return { svg, cursor, lines, frame: numbers("frame"), time: numbers("time"), values: numbers("values") };
  });
  const dots = [...document.querySelectorAll("circle[data-track]")].map((dot) => ({
    dot,
    track: dot.dataset.track.split(" ").map((place) => place.split(",")),
  }));
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  document.body.append(tip);

  const place = (lines, x) => {
    const run = lines.find((run) => x >= run[0][0] - 0.5 && x <= run[run.length - 1][0] + 0.5);
    if (!run) return null;
    const next = Math.max(1, run.findIndex((point) => point[0] >= x));
    const [a, b] = [run[next - 1], run[next] || run[next - 1]];
    const share = b[0] > a[0] ? Math.min(1, Math.max(0, (x - a[0]) / (b[0] - a[0]))) : 0;
    return a[1] + share * (b[1] - a[1]);
  };

  const show = (chart, event) => {
    const box = chart.svg.getBoundingClientRect();
    const [left, right] = chart.frame;
    const x = ((event.clientX - box.left) / box.width) * chart.svg.viewBox.baseVal.width;
    const share = Math.min(1, Math.max(0, (x - left) / (right - left)));
    for (const { cursor, frame } of charts) {
      cursor.setAttribute("d", `M${frame[0] + share * (frame[1] - frame[0])} ${frame[2]}V${frame[3]}`);
    }
    for (const { dot, track } of dots) {
      const [cx, cy] = track[Math.round(share * (track.length - 1))];
      dot.setAttribute("cx", cx);
      dot.setAttribute("cy", cy);
      dot.classList.add("shown");
    }
    const [from, to] = chart.time;
    const time = `${(from + share * (to - from)).toFixed(2)} s`;
    const list = document.createElement("dl");
    for (const { path, name, runs } of chart.lines) {
      const y = place(runs, left + share * (right - left));
      if (y === null) continue;
      const [low, high] = chart.values;
      const [, , top, bottom] = chart.frame;
      const value = low + ((bottom - y) / (bottom - top)) * (high - low);
      const digits = Math.max(0, Math.min(4, 3 - Math.floor(Math.log10(high - low))));
      const [dt, dd] = ["dt", "dd"].map((tag) => document.createElement(tag));
      dt.textContent = name;
      dt.style.borderColor = getComputedStyle(path).stroke;
      dd.textContent = value.toFixed(digits);
      list.append(dt, dd);
    }
    tip.replaceChildren(time, list);
    tip.hidden = false;
    const aside = event.clientX + 18 + tip.offsetWidth > document.documentElement.clientWidth;
    tip.style.left = `${Math.max(4, aside ? event.clientX - 14 - tip.offsetWidth : event.clientX + 18)}px`;
    tip.style.top = `${Math.max(4, Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 4))}px`;
  };
  const hide = () => {
    tip.hidden = true;
    for (const { cursor } of charts) cursor.setAttribute("d", "");
    for (const { dot } of dots) dot.classList.remove("shown");
  };
  for (const chart of charts) {
    chart.svg.addEventListener("pointermove", (event) => show(chart, event));
    chart.svg.addEventListener("pointerdown", (event) => show(chart, event));
    chart.svg.addEventListener("pointerleave", hide);
  }
})();
