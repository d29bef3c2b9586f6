"use strict";
(() => {
  const tip = document.getElementById("tip");
  const show = (text, x, y) => {
    tip.textContent = text;
    tip.hidden = false;
    const half = tip.offsetWidth / 2 + 8;
    tip.style.left = Math.min(Math.max(x, half), innerWidth - half) + "px";
    tip.style.top = (y - tip.offsetHeight - 12 < 0 ? y + 20 : y - tip.offsetHeight - 12) + "px";
  };
  const hide = () => { tip.hidden = true; };

  // The browser's own title bubbles are slow and do not show on touch: ours take their text over.
  for (const title of document.querySelectorAll("figure.chart svg title")) {
    const mark = title.parentNode;
    const text = title.textContent;
    title.remove();
    mark.addEventListener("pointermove", (event) => show(text, event.clientX, event.clientY));
    mark.addEventListener("pointerleave", hide);
  }

  // Curves have too many points for a mark each: find the nearest of every line instead.
  const written = (v) => (v !== 0 && (Math.abs(v) < 0.001 || Math.abs(v) >= 1e6) ? v.toExponential(2) : +v.toPrecision(3));
  for (const chart of document.querySelectorAll("svg.curve")) {
    const [x0, x1, ...label] = chart.dataset.x.split(" ");
    const [y0, y1, log] = chart.dataset.y.split(" ").map(Number);
    const box = { left: 42, right: 348, top: 12, bottom: 182 };
    const lines = [...chart.querySelectorAll("polyline")].map((line) => ({ name: line.dataset.name, points: [...line.points] }));
    chart.addEventListener("pointermove", (event) => {
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse());
      if (at.x < box.left || at.x > box.right) return hide();
      const share = (at.x - box.left) / (box.right - box.left);
      const rows = [`${label.join(" ")} ${Math.round(+x0 + share * (x1 - x0))}`];
      for (const line of lines.filter((each) => each.points.length)) {
        const near = line.points.reduce((a, b) => (Math.abs(b.x - at.x) < Math.abs(a.x - at.x) ? b : a));
        const up = (box.bottom - near.y) / (box.bottom - box.top);
        rows.push(`${line.name}: ${written(log ? y0 * (y1 / y0) ** up : y0 + up * (y1 - y0))}`);
      }
      show(rows.join("\n"), event.clientX, event.clientY);
    });
    chart.addEventListener("pointerleave", hide);
  }

  for (const button of document.querySelectorAll("[data-copy]")) {
    button.hidden = false;
    button.addEventListener("click", async () => {
      const source = document.getElementById(button.dataset.copy);
      try {
        await navigator.clipboard.writeText(source.textContent);
        button.textContent = "Copied";
      } catch {
        getSelection().selectAllChildren(source); // no clipboard on file: pages of some browsers
        button.textContent = "Selected";
      }
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
  }

  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((each) => { each.open = true; }));
  addEventListener("scroll", hide, { passive: true });
})();
