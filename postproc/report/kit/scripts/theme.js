"use strict";
// Colours of the style sheet for what the plot library draws, and a signal that they have changed.
const theme = (() => {
  const PAPER = 660; // width of a plot on paper, pixels: A4 and Letter with usual margins
  const width = (element) => (printing ? PAPER : element.clientWidth);
  const listeners = [];
  const light = document.styleSheets[0].cssRules[0].style; // the first rule of the style sheet
  let printing = false;
  const colour = (name) => (printing ? light : getComputedStyle(document.documentElement)).getPropertyValue(`--${name}`).trim();
  const notify = () => listeners.forEach((redraw) => redraw());
  const print = (begins) => () => {
    printing = begins;
    notify();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", notify);
  addEventListener("beforeprint", print(true));
  addEventListener("afterprint", print(false));

  // Colours of values, from the lowest to the highest, distinct for colour-blind eyes too: cividis, and orange to blue.
  const scales = {
    rising: ["#00204c", "#053571", "#404d6b", "#606370", "#7c7b77", "#9b9477", "#bcae6e", "#dfca5d", "#ffe945"],
    about: ["#b35806", "#f7f7f7", "#053061"],
  };
  const scale = (name) => scales[name].map((stop, k, all) => [k / (all.length - 1), stop]);
  // The colour at a share of a scale.
  function shade(scale, share) {
    const k = Math.min(Math.max(scale.findIndex(([at]) => at >= share), 1), scale.length - 1);
    const [[from, low], [to, high]] = [scale[k - 1], scale[k]];
    const part = (text, c) => parseInt(text.slice(1 + 2 * c, 3 + 2 * c), 16);
    return `rgb(${[0, 1, 2].map((c) => Math.round(part(low, c) + ((share - from) / (to - from)) * (part(high, c) - part(low, c))))})`;
  }

  // What all plots share: no paper of their own, the page's font and rules.
  const axis = (more = {}) => ({
    gridcolor: colour("rule"), linecolor: colour("rule"), zerolinecolor: colour("rule"), automargin: true,
    exponentformat: "none", ...more,
  });
  const layout = (more = {}) => ({
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false,
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colour("soft") },
    hoverlabel: { bgcolor: colour("card"), bordercolor: colour("rule"), font: { color: colour("ink") } },
    margin: { l: 56, r: 16, t: 10, b: 40 }, width: printing ? PAPER : undefined, autosize: !printing, ...more,
  });
  const config = { responsive: true, displaylogo: false, displayModeBar: false,
    plotGlPixelRatio: Math.min(devicePixelRatio, 2) };
  return { get printing() { return printing; }, colour, width, scales, scale, shade, axis, layout, config, onChange: (redraw) => listeners.push(redraw) };
})();
