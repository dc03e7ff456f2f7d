"use strict";
// The traces.
(async () => {
  const viewer = document.getElementById("trace-viewer");
  if (!viewer) return;
  const { draw, node, fillOptions, unpacked } = Report;
  const byId = (id) => document.getElementById(`trace-${id}`);
  const data = await unpacked(byId("data")).json();
  const episodeSelect = byId("episode"), jointSelect = byId("joint"), signalSelect = byId("signal");
  const degrees = byId("degrees"), figure = byId("figure");
  const hidden = new Set(data.hidden);
  const decoded = decode(new Uint8Array(await unpacked(byId("curves")).arrayBuffer()));
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const isMotion = (signal) => signal === "position" || signal === "velocity";

  // As embed.py packs them: changes of 16-bit codes, the low bytes of all before the high ones.
  function decode(bytes) {
    const count = bytes.length / 2;
    let place = 0;
    const take = (rows, [middle, step]) => {
      const values = new Float32Array(rows);
      let code = 0;
      for (let row = 0; row < rows; row += 1, place += 1) {
        const folded = bytes[place] | (bytes[count + place] << 8);
        code = ((code + ((folded >> 1) ^ -(folded & 1))) << 16) >> 16;
        values[row] = code === -32768 ? NaN : middle + step * code;
      }
      return values;
    };
    return data.episodes.map((episode) => episode.traces.map((item) => {
      const [time, ...taken] = item.codes.map((code) => take(item.rows, code));
      const values = Object.fromEntries(item.curves.map((label, number) => [label, taken[number]]));
      const [middle] = item.codes[1 + item.curves.indexOf("measured")];
      const base = values.measured.map((value) => (Number.isNaN(value) ? middle : value));
      for (const label of item.curves)
        if (label !== "measured") values[label] = values[label].map((away, row) => base[row] + away);
      return { ...item, time, values };
    }));
  }

  function current() {
    const number = Number(episodeSelect.value);
    const trace = decoded[number].find((item) => item.joint === jointSelect.value && item.signal === signalSelect.value);
    return { episode: data.episodes[number], trace };
  }

  // Joints and signals that this motion has; the choice is kept where it exists.
  function fillMenus(joint, signal) {
    const traces = data.episodes[Number(episodeSelect.value)].traces;
    const joints = data.joints.filter((name) => traces.some((item) => item.joint === name));
    const chosen = fillOptions(jointSelect, joints.map((name) => [name, name]), joint);
    const signals = data.signals.filter((name) => traces.some((item) => item.joint === chosen && item.signal === name));
    fillOptions(signalSelect, signals.map((name) => [name, name]), signal);
  }

  function fillEpisodes() {
    const groups = new Map();
    data.episodes.forEach((episode, number) => {
      if (!groups.has(episode.splitTitle)) groups.set(episode.splitTitle, node("optgroup", undefined, { label: episode.splitTitle }));
      groups.get(episode.splitTitle).append(node("option", episode.id, { value: number }));
    });
    episodeSelect.replaceChildren(...(groups.size > 1 ? groups.values() : [...groups.values()].flatMap((group) => [...group.children])));
  }

  const style = (label, colors) => label === "measured"
    ? { color: colors.measured, dash: "solid", title: "measured" } : data.styles[label];
  const inOrder = (labels) => ["measured", ...data.runs].filter((label) => labels.includes(label));
  const title = (label) => (label === data.command ? "command" : style(label, {}).title);

  function lines(trace, scale, colors) {
    const shown = inOrder(trace.curves).filter((label) => !hidden.has(label));
    const line = (label) => ({ color: style(label, colors).color, dash: style(label, colors).dash, width: label === "measured" ? 2.2 : 1.6 });
    const scaled = (values) => (scale === 1 ? values : values.map((value) => value * scale));
    const curves = shown.map((label) => ({
      type: "scatter", mode: "lines", name: plain(title(label)), x: trace.time, y: scaled(trace.values[label]),
      line: line(label), hovertemplate: "%{y:.4~g}",
    }));
    const residuals = shown.filter((label) => label !== "measured" && (label !== data.command || isMotion(trace.signal)));
    return curves.concat(residuals.map((label) => ({
      type: "scatter", mode: "lines", name: plain(`residual ${title(label)}`), x: trace.time,
      y: scaled(trace.values.measured.map((value, row) => value - trace.values[label][row])),
      line: line(label), yaxis: "y2", showlegend: false, hovertemplate: "%{y:.4~g}",
    })));
  }

  const concerns = (flag, trace) => (!flag.joint || flag.joint === trace.joint) && (!flag.signal || flag.signal === trace.signal);

  function marks(episode, trace) {
    return episode.flags.filter((flag) => concerns(flag, trace) && flag.start_s !== null).map((flag) => {
      const start = flag.start_s - episode.start_s;
      const end = (flag.end_s === null ? flag.start_s : flag.end_s) - episode.start_s;
      return { type: "rect", xref: "x", yref: "paper", x0: start, x1: end, y0: 0, y1: 1, layer: "below",
               fillcolor: "rgba(213,94,0,0.14)", line: { color: "rgba(213,94,0,0.55)", width: 1, dash: "dot" } };
    });
  }

  function unitText(unit, inDegrees) {
    return (inDegrees ? unit.replace("rad", "deg") : unit).replace("^2", "²");
  }

  function makeFigure(episode, trace, colors) {
    const inDegrees = degrees.checked && trace.unit.startsWith("rad");
    const unit = unitText(trace.unit, inDegrees);
    const named = (text) => ({ text: plain(unit === "1" ? text : `${text} [${unit}]`) });
    return {
      data: lines(trace, inDegrees ? 180 / Math.PI : 1, colors),
      layout: {
        height: 500, hovermode: "x unified", shapes: marks(episode, trace), uirevision: JSON.stringify([episode.id, trace.joint, trace.signal, inDegrees]),
        hoversubplots: "axis", legend: { itemclick: false, itemdoubleclick: false },
        showlegend: true,
        xaxis: { title: { text: "time since the first sample [s]" }, anchor: "y2", domain: [0, 1] },
        yaxis: { title: named(trace.signal), domain: [0.36, 1] },
        yaxis2: { title: named("residual"), domain: [0, 0.3], anchor: "x" },
      },
    };
  }

  function describe(episode, trace) {
    const errors = ((episode.errors[trace.signal] || {})[trace.joint]) || {};
    const listed = data.runs.filter((label) => Object.hasOwn(errors, label)).map((label) => `${title(label)} ${errors[label]}`);
    byId("errors").textContent = listed.length ? `RMSE of this motion and joint: ${listed.join("; ")}.` : "";
    byId("size").textContent = trace.rows < trace.samples
      ? `${trace.rows} of ${trace.samples} samples are drawn.` : `All ${trace.samples} samples are drawn.`;
    const notes = episode.flags.filter((flag) => concerns(flag, trace));
    byId("flags").replaceChildren(...notes.map((flag) => node("li", `Flag ${flag.kind.replaceAll("_", " ")}: ${flag.detail}`)));
    figure.setAttribute("aria-label",
      `${trace.signal} of joint ${trace.joint} in motion ${episode.id}: ${inOrder(trace.curves).map(title).join(", ")}, and residuals below`);
  }

  function fillRuns(trace) {
    const labels = inOrder(trace.curves).slice(1);
    const boxes = labels.map((label) => {
      const box = node("input", undefined, { type: "checkbox", value: label, autocomplete: "off" });
      box.checked = !hidden.has(label);
      box.addEventListener("change", () => { hidden[box.checked ? "delete" : "add"](label); show(); });
      const wrapper = node("label");
      wrapper.append(box, title(label));
      return wrapper;
    });
    const legend = byId("runs").querySelector("legend");
    byId("runs").replaceChildren(legend, ...boxes);
  }

  function show() {
    const { episode, trace } = current();
    draw(figure, (colors) => makeFigure(episode, trace, colors), { interactive: true });
    byId("degrees-label").hidden = !trace.unit.startsWith("rad");
    describe(episode, trace);
  }

  function refresh(joint, signal) {
    fillMenus(joint, signal);
    fillRuns(current().trace);
    show();
  }

  const again = () => refresh(jointSelect.value, signalSelect.value);

  function step(select, by) {
    const count = select.options.length;
    select.selectedIndex = (select.selectedIndex + by + count) % count;
    again();
  }

  function open(id, joint, signal) {
    const number = data.episodes.findIndex((episode) => episode.id === id);
    if (number < 0) return;
    episodeSelect.value = String(number);
    refresh(joint || jointSelect.value, signal || signalSelect.value);
    document.getElementById("traces").scrollIntoView();
    figure.focus({ preventScroll: true });
  }

  [episodeSelect, jointSelect, signalSelect].forEach((select) => select.addEventListener("change", again));
  degrees.addEventListener("change", show);
  byId("previous").addEventListener("click", () => step(episodeSelect, -1));
  byId("next").addEventListener("click", () => step(episodeSelect, 1));
  figure.addEventListener("keydown", (event) => {
    const action = { ArrowLeft: [episodeSelect, -1], ArrowRight: [episodeSelect, 1],
                     ArrowUp: [jointSelect, -1], ArrowDown: [jointSelect, 1] }[event.key];
    if (!action || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    step(...action);
  });
  document.addEventListener("click", (event) => {
    const row = event.target.closest("[data-trace-episode]");
    if (row) open(row.dataset.traceEpisode, row.dataset.traceJoint, row.dataset.traceSignal);
  });

  fillEpisodes();
  const first = data.episodes.findIndex((episode) => episode.id === data.start.episode);
  episodeSelect.value = String(Math.max(first, 0));
  refresh(data.start.joint, data.start.signal);
})();
