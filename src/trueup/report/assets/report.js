"use strict";
// Menus, tables and figures. Every text is set with textContent, never as HTML.
const Report = (() => {
  const drawn = new Map();
  const ready = unpack();
  const coarse = window.matchMedia("(pointer: coarse)").matches;

  // What gzip has packed and base64 made text of.
  function unpacked(element) {
    const bytes = Uint8Array.from(atob(element.textContent), (character) => character.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
  }

  // Until the library that draws is there, tables and menus work without it.
  async function unpack() {
    try {
      document.head.append(node("script", await unpacked(document.getElementById("library")).text()));
    } catch {
      document.querySelector("main").prepend(node("p", "Figures and menus need a browser of 2023 or later.", { class: "notice" }));
      throw new Error("the library that draws cannot be unpacked");
    }
  }

  function theme() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(`--${name}`).trim();
    return { ink: color("ink"), muted: color("muted"), grid: color("grid"), line: color("line"),
             paper: color("paper"), raised: color("raised"), measured: color("measured") };
  }

  function themed(layout, colors) {
    const result = {
      ...layout,
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: colors.ink },
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      margin: { l: 10, r: 12, t: 8, b: 10, ...layout.margin },
      legend: { orientation: "h", x: 0, y: 1.02, xanchor: "left", yanchor: "bottom", ...layout.legend },
      hoverlabel: { bgcolor: colors.paper, bordercolor: colors.line, font: { color: colors.ink }, namelength: -1 },
      modebar: { orientation: "v", bgcolor: "rgba(0,0,0,0)", color: colors.muted, activecolor: colors.ink },
      autosize: true,
    };
    for (const [key, axis] of Object.entries(layout)) {
      if (!/^[xy]axis/.test(key)) continue;
      result[key] = {
        automargin: true, gridcolor: colors.grid, zerolinecolor: colors.line, linecolor: colors.line,
        tickcolor: colors.line, zerolinewidth: 1, ...axis,
        title: axis.title ? { standoff: 10, ...axis.title, font: { size: 12.5, color: colors.muted } } : undefined,
      };
    }
    return result;
  }

  // interactive: zoom and toolbar; bars and dots only answer to the pointer
  function draw(element, make, { interactive = false } = {}) {
    drawn.set(element, () => draw(element, make, { interactive }));
    const colors = theme();
    const figure = make(colors);
    const layout = themed(figure.layout, colors);
    if (!interactive || coarse) layout.dragmode = false;
    const data = figure.data.map((trace) =>
      trace.error_x ? { ...trace, error_x: { ...trace.error_x, color: trace.error_x.color || colors.ink } } : trace);
    element.style.minHeight = `${layout.height}px`;
    const settings = {
      displaylogo: false, responsive: true,
      displayModeBar: interactive && !coarse && window.innerWidth > 640 ? "hover" : false, // it would cover the legend
      modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]], doubleClick: "reset",
      showSendToCloud: false, plotlyServerURL: "",
    };
    const show = () => Plotly.react(element, data, layout, settings);
    return window.Plotly ? show() : ready.then(show);
  }

  const redraw = () => drawn.forEach((again) => again());

  function node(tag, text, attributes = {}) {
    const element = document.createElement(tag);
    if (text !== undefined) element.textContent = text;
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    return element;
  }

  // Names are long: they may go on in the next line after / and +, and before [.
  function breakable(element, text) {
    text.split(/(?<=[/+])|(?=\[)/).forEach((part, number) => element.append(...(number ? [node("wbr"), part] : [part])));
    return element;
  }

  function fillTable(container, table) {
    container.hidden = !table;
    container.replaceChildren();
    if (!table) return;
    const element = node("table");
    const caption = element.createCaption();
    caption.append(node("span", table.caption));
    const head = element.createTHead().insertRow();
    table.columns.forEach((text) => head.append(breakable(node("th", undefined, { scope: "col" }), text)));
    const body = element.createTBody();
    for (const row of table.rows) {
      const line = body.insertRow();
      if (row.strong) line.className = "strong";
      const heading = breakable(node("th", undefined, { scope: "row" }), row.head);
      if (row.note) heading.append(node("span", row.note, { class: "note" }));
      line.append(heading);
      for (const item of row.cells) {
        const cell = node("td", item.text || "");
        if (item.tone) cell.className = item.tone;
        if (item.extra) cell.append(" ", node("span", item.extra, { class: "extra" }));
        if (item.note) cell.append(node("span", item.note, { class: "note" }));
        line.append(cell);
      }
    }
    container.append(element);
    reach(container);
  }

  // A region that needs no scrolling is no stop of the tab key.
  function reach(region) {
    const more = region.scrollWidth > region.clientWidth + 1 || region.scrollHeight > region.clientHeight + 1;
    region.tabIndex = more ? 0 : -1;
  }

  function select(element) {
    const selection = window.getSelection();
    selection.removeAllRanges();
    const range = document.createRange();
    range.selectNodeContents(element);
    selection.addRange(range);
  }

  // Without a clipboard (an old browser, no permission) the lines are selected, and the keys say the rest.
  async function copy(lines) {
    try {
      await navigator.clipboard.writeText(lines.textContent);
      return "Copied.";
    } catch {
      select(lines);
      return document.execCommand("copy") ? "Copied." : "Selected: copy with Ctrl+C.";
    }
  }

  function setUpCopying(container) {
    const button = container.querySelector("button"), lines = container.querySelector("pre");
    button.hidden = false;
    button.addEventListener("click", async () => {
      container.querySelector(".copied").textContent = await copy(lines);
    });
  }

  function fillOptions(select, options, wanted) {
    select.replaceChildren(...options.map(([value, text]) => node("option", text, { value })));
    select.value = options.some(([value]) => value === wanted) ? wanted : options[0][0];
    return select.value;
  }

  function showVariant(container, variant) {
    for (const slot of container.querySelectorAll("[data-table]")) fillTable(slot, variant.tables[slot.dataset.table]);
    for (const slot of container.querySelectorAll("[data-figure]")) {
      const figure = variant.figures[slot.dataset.figure];
      if (figure) draw(slot, () => figure);
    }
  }

  async function setUpChooser(container) {
    const { menus, variants, default: first } = await unpacked(container.querySelector(".chooser-data")).json();
    const selects = [...container.querySelectorAll("select[data-level]")];
    // A choice that does not exist under the menus before it falls back to the first that does.
    function choose(path) {
      let branch = variants;
      menus.forEach((menu, level) => {
        const options = menu.options.filter(([value]) => Object.hasOwn(branch, value));
        let value = options.some(([name]) => name === path[level]) ? path[level] : options[0][0];
        if (selects[level]) value = fillOptions(selects[level], options, value);
        branch = branch[value];
      });
      showVariant(container, branch);
    }
    selects.forEach((select) => select.addEventListener("change", () => choose(selects.map((item) => item.value))));
    choose(first);
  }

  function sortBy(header) {
    const table = header.closest("table");
    const column = [...header.parentElement.children].indexOf(header);
    const numeric = header.hasAttribute("data-numeric");
    const now = header.getAttribute("aria-sort");
    const descending = now ? now === "ascending" : numeric;
    const key = (row) => {
      const cell = row.cells[column];
      return numeric ? Number(cell.dataset.value) : cell.textContent.trim();
    };
    const missing = (value) => Number.isNaN(value);
    const rows = [...table.tBodies[0].rows].map((row) => [key(row), row]);
    rows.sort(([a], [b]) => {
      if (missing(a) || missing(b)) return missing(a) - missing(b);
      const order = numeric ? a - b : a.localeCompare(b, "en", { numeric: true });
      return descending ? -order : order;
    });
    table.tBodies[0].append(...rows.map(([, row]) => row));
    for (const other of header.parentElement.children) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", descending ? "descending" : "ascending");
  }

  function setUpPrinting() {
    const width = 680; // A4 without margins at 96 dpi
    window.addEventListener("beforeprint", () => {
      document.querySelectorAll("details").forEach((item) => { item.open = true; });
      redraw();
      for (const element of drawn.keys()) Plotly.relayout(element, { width });
    });
    window.addEventListener("afterprint", () => {
      for (const element of drawn.keys()) Plotly.relayout(element, { width: null, autosize: true });
      redraw();
    });
  }

  document.querySelectorAll(".chooser").forEach(setUpChooser);
  document.querySelectorAll(".copy").forEach(setUpCopying);
  const watch = new ResizeObserver((entries) => entries.forEach(({ target }) => reach(target)));
  document.querySelectorAll(".scroll, .copy pre").forEach((region) => watch.observe(region));
  document.querySelectorAll("table.sortable thead th button").forEach((button) =>
    button.addEventListener("click", () => sortBy(button.closest("th"))));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  setUpPrinting();
  return { draw, node, fillOptions, unpacked };
})();
