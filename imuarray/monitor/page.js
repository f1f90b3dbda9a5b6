"use strict";
// Asks for the log's snapshot again and again and shows it. Every text of the log is set as text, never as markup.

const query = location.search;
const everyMs = Number(document.body.dataset.everyMs);
const LONGEST_WAIT_MS = 30000;
const ENDED_MS = 10000;
const dark = matchMedia("(prefers-color-scheme: dark)");
const byId = (id) => document.getElementById(id);
const LABELS = {
  specific_force: "Specific force", angular_rate: "Angular rate", magnetic_field: "Magnetic field",
  pressure: "Air pressure", temperature: "Temperature",
};
const DIGITS = { g: 3, dps: 2, gauss: 3, hPa: 2, mg: 1, counts: 0 };

function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

function shown(value, digits) {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}
const silent = (sensor) => (sensor.silent_s === null ? "" : `silent ${duration(sensor.silent_s)}`);
const whole = (value) => value.toLocaleString("en-GB");

function duration(seconds) {
  if (seconds < 120) return `${seconds.toFixed(0)} s`;
  if (seconds < 7200) return `${(seconds / 60).toFixed(0)} min`;
  return seconds < 172800 ? `${(seconds / 3600).toFixed(1)} h` : `${(seconds / 86400).toFixed(0)} d`;
}

// Text is changed only where it differs: what reads the page aloud is left in peace.
function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// ---- figures -------------------------------------------------------------------------------------------------------

let figures = null;
let colours = 0; // counts changes of the theme: what was begun before one is done again
let asked = -1;
const slots = new Map();
if (typeof Bokeh !== "undefined") Bokeh.set_log_level("error"); // it warns of figures that have no data yet

const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const slot = slots.get(entry.target);
    if (slot) {
      slot.visible = entry.isIntersecting;
      draw(slot);
    }
  }
}, { rootMargin: "150px" });

function figure(key, label) {
  const node = make("div", { class: "figure", role: "img", "aria-label": label });
  slots.set(node, { node, key, visible: false, data: null, busy: false, place: null, colours: -1 });
  seen.observe(node);
  return node;
}

async function fetchFigures() {
  if (asked === colours) return;
  const mine = asked = colours;
  try {
    const theme = `theme=${dark.matches ? "dark" : "light"}`;
    const answer = await fetch(`figures.json${query ? `${query}&${theme}` : `?${theme}`}`);
    const found = answer.ok ? await answer.json() : null;
    if (mine === colours) figures = found;
  } catch (error) {
    console.warn(error);
  }
  if (!figures && asked === mine) asked = -1; // once more, with the next snapshot
  slots.forEach(draw);
}

function take(slot) {
  if (slot.place) Bokeh.documents.splice(Bokeh.documents.indexOf(slot.place), 1);
  slot.place = null;
  slot.node.replaceChildren();
}

async function embed(slot) {
  const mine = colours;
  slot.busy = true;
  try {
    take(slot);
    const views = await Bokeh.embed.embed_item(structuredClone(figures[slot.key]), slot.node);
    slot.place = [...views][0].model.document;
    slot.colours = mine;
  } finally {
    slot.busy = false;
  }
}

async function draw(slot) {
  if (!slot.visible || slot.busy || !slot.data || typeof Bokeh === "undefined") return;
  while (slot.colours !== colours) {
    if (!figures) fetchFigures();
    if (!figures || !figures[slot.key]) return;
    await embed(slot);
  }
  const data = {};
  for (const [name, column] of Object.entries(slot.data)) data[name] = column.map((one) => (one === null ? NaN : one));
  slot.place.get_model_by_name("source").data = data;
  if (data.f) decades(["x", "y"].map((name) => slot.place.get_model_by_name(name)), data);
}

// Whole decades, so that the axes of a spectrum stand still.
function decades([overF, overDensity], data) {
  const known = Object.entries(data).flatMap(([name, column]) => (name === "f" ? [] : column.filter((one) => one > 0)));
  overF.setv({ start: data.f[0], end: data.f[data.f.length - 1] });
  if (known.length) {
    const edge = (round, value) => 10 ** round(Math.log10(value));
    overDensity.setv({ start: edge(Math.floor, Math.min(...known)), end: edge(Math.ceil, Math.max(...known)) });
  }
}

function feed(node, data) {
  const slot = slots.get(node);
  slot.data = data;
  draw(slot);
}

function forgetFigures() {
  colours += 1;
  figures = null;
  fetchFigures();
}
dark.addEventListener("change", forgetFigures);

// Other cards in the place of those that are there.
function deal(box, cards) {
  for (const node of box.querySelectorAll(".figure")) {
    seen.unobserve(node);
    if (slots.get(node).place) take(slots.get(node));
    slots.delete(node);
  }
  box.replaceChildren(...cards);
}

// ---- what is shown -------------------------------------------------------------------------------------------------

function tile(name, value, more, warn) {
  const box = make("div", warn ? { class: "warn" } : {}, make("dt", {}, name));
  box.append(make("dd", {}, make("div", { class: "value" }, value), make("div", { class: "more" }, more)));
  return box;
}

function tiles(now) {
  const part = now.counted < 1 ? `${Math.floor(now.counted * 100)} % of the log counted` : "since the log began";
  const events = Object.values(now.events).reduce((sum, count) => sum + count, 0);
  const kinds = Object.entries(now.events).map(([kind, count]) => `${kind} ${count}`).join(", ");
  const disk = now.disk;
  const left = disk && disk.left_s !== null ? `about ${duration(disk.left_s)} of logging` : "";
  const short = disk && disk.left_s !== null && disk.left_s < 3600;
  byId("tiles").replaceChildren(
    tile("Frame rate", `${shown(now.rate_hz, 1)} Hz`, `${now.frame_rate_hz ? `of ${Number(now.frame_rate_hz.toPrecision(5))} requested, ` : ""}${duration(now.ends_s - now.begins_s)} recorded`),
    tile("Missed", whole(now.missed), "frames since the log began", now.missed > 0),
    tile("Delayed", whole(now.delayed), `frames by more than a quarter of a period, ${part}`, false),
    tile("Events", whole(events), kinds || "none", now.problems > 0),
    tile("Disk left", disk ? `${(disk.free_bytes / 2 ** 30).toFixed(1)} GiB` : "–", left, short),
    tile("Newest row", now.quiet_s < 3 ? "now" : `${duration(now.quiet_s)} ago`, now.phase ? `phase ${now.phase}` : "",
      now.state === "being written" && now.quiet_s >= 5),
  );
}

function axes(columns, values, smalls, use) {
  const list = make("ul", { class: "axes" });
  columns.forEach((name, index) => {
    const item = make("li", { class: `axis-${index}` }, make("b", {}, name), values[index]);
    if (smalls) item.append(make("small", {}, smalls[index]));
    if (use) {
      const percent = Math.min(100, use[index] ?? 0);
      const bar = make("div", { class: percent > 95 ? "bar full" : "bar", "aria-hidden": "true" }, make("i"));
      bar.firstChild.style.width = `${percent}%`;
      item.append(bar);
    }
    list.append(item);
  });
  return list;
}

// A result that is fused during the recording waits for all sensors.
function delayText(result) {
  const newest = Math.max(...Object.values(result.quantities).map((one) => one.trace.t.at(-1) ?? 0));
  return newest < -0.5 ? ` It is delayed by ${shown(-newest, 1)} s.` : "";
}

function fused(now) {
  const box = byId("fused");
  const result = now.fused;
  write(byId("fused-hint"), result
    ? `${result.technique === "mean" ? "Simple average of all sensors" : `Technique: ${result.technique}`}, box frame, with ${result.calibrated ? "the given calibration" : "data-sheet values"}. Noise is the scatter from frame to frame.${delayText(result)}`
    : `Not fused: ${now.not_fused}`);
  const quantities = result ? Object.entries(result.quantities) : [];
  const signature = quantities.map(([name]) => name).join();
  if (box.dataset.holds !== signature) {
    box.dataset.holds = signature;
    deal(box, quantities.map(([name, one]) => make("article", { class: "card" },
      make("div", { class: "head" }, make("h3", {}, LABELS[name] ?? name), make("span", {}, one.unit)),
      make("div", { class: "now" }),
      figure(`trace|x,y,z|${one.unit}`, `${LABELS[name] ?? name}, fused, over the last seconds; its values stand above`))));
  }
  quantities.forEach(([, one], index) => {
    const digits = DIGITS[one.unit] ?? 2;
    const card = box.children[index];
    card.querySelector(".now").replaceChildren(axes(["x", "y", "z"], one.mean.map((value) => shown(value, digits)),
      one.noise.map((value) => `noise ${shown(value, digits + 1)}`)));
    feed(card.querySelector(".figure"), one.trace);
  });
}

function row(sensor) {
  const digits = DIGITS[sensor.unit] ?? 3;
  const triad = sensor.columns.length === 3;
  const means = triad ? sensor.mean : [sensor.mean[0], undefined, undefined];
  const sd = sensor.sd.some((one) => one !== null) ? Math.max(...sensor.sd.map((one) => one ?? 0)) : null;
  const use = sensor.use_percent ? Math.max(...sensor.use_percent) : null;
  const flags = Object.entries(sensor.flags).map(([name, count]) => `${name.replace("_", " ")} ${count}`).join(", ");
  const warm = sensor.temperature_degc === null ? "" : shown(sensor.temperature_degc, 1) + (sensor.temperature_is_relative ? "*" : "");
  const number = (text, warn) => make("td", { class: warn ? "n warn" : "n" }, text);
  return make("tr", {}, make("th", { scope: "row" }, sensor.name), make("td", {}, sensor.chip),
    number(silent(sensor) || shown(sensor.rate_hz, 1), silent(sensor)), ...means.map((value) => number(value === undefined ? "" : shown(value, digits))),
    make("td", {}, sensor.unit), number(shown(sd, digits + 1)), number(use === null ? "" : `${use.toFixed(0)} %`, use > 95),
    number(warm), number(whole(sensor.missed), sensor.missed > 0), make("td", {}, flags));
}

function rangeUsed(use, peak) {
  return peak - use > 1 ? `${shown(use, 0)} %, peak ${shown(peak, 0)} %` : `${shown(use, 0)} % of range`;
}

function card(sensor) {
  const key = sensor.columns.join(",");
  const label = `${sensor.name}, ${LABELS[sensor.quantity] ?? sensor.quantity}`;
  const node = make("article", { class: "card" },
    make("div", { class: "head" }, make("h3", {}, sensor.name), make("span", { class: "what" })),
    make("div", { class: "now" }),
    figure(`trace|${key}|${sensor.unit}`, `${label} over the last seconds; its values stand above`));
  if (sensor.columns.length === 3) {
    node.append(make("p", { class: "label" }, "Spectrum of the last seconds"),
      figure(`density|${key}|${sensor.density_unit}`, `${label}: amplitude spectral density of the last seconds`));
  }
  return node;
}

function sensors(now) {
  byId("sensors").tBodies[0].replaceChildren(...now.sensors.map(row));
  byId("relative").hidden = !now.sensors.some((sensor) => sensor.temperature_is_relative);
  const box = byId("cards");
  const signature = now.sensors.map((sensor) => `${sensor.name}|${sensor.unit}|${sensor.columns}`).join();
  if (box.dataset.holds !== signature) {
    box.dataset.holds = signature;
    deal(box, now.sensors.map(card));
    if (figures) forgetFigures();
  }
  now.sensors.forEach((sensor, index) => {
    const node = box.children[index];
    const digits = DIGITS[sensor.unit] ?? 3;
    const warm = sensor.temperature_degc === null ? ""
      : `, ${shown(sensor.temperature_degc, 1)}${sensor.temperature_is_relative ? "*" : ""} °C`;
    const what = node.querySelector(".what");
    what.classList.toggle("warn", sensor.silent_s !== null);
    write(what, `${sensor.chip}, ${silent(sensor) || `${shown(sensor.rate_hz, 1)} Hz`}${warm}`);
    const uses = sensor.use_percent;
    const peaks = sensor.peak_use_percent;
    const smalls = sensor.columns.map((_, axis) => uses
      ? rangeUsed(uses[axis], peaks[axis]) : `SD ${shown(sensor.sd[axis], digits + 1)}`);
    const values = sensor.mean.map((value) => `${shown(value, digits)} ${sensor.unit}`);
    node.querySelector(".now").replaceChildren(axes(sensor.columns, values, smalls, uses));
    const [trace, density] = node.querySelectorAll(".figure");
    feed(trace, sensor.trace);
    if (density) density.hidden = node.querySelector(".label").hidden = !sensor.density; // too few rows for one
    if (density && sensor.density) feed(density, sensor.density);
  });
}

let told = null; // how many events there were when they were last looked at

function aloud(news) {
  const words = news.slice(0, 3).map((event) => `${event.sensor || "array"} ${event.kind}: ${event.message}`);
  return words.join("; ") + (news.length > 3 ? `; and ${news.length - 3} more` : "");
}

function events(now) {
  const count = Object.values(now.events).reduce((sum, one) => sum + one, 0);
  write(byId("events-hint"), count
    ? `${whole(count)} in all, ${whole(now.problems)} of them faults (▲). The newest first; events that differ in numbers only are one line with their count.`
    : "Nothing happened so far: no reading lost, no sensor set up again.");
  if (told !== null && count > told) write(byId("events-new"), aloud(now.recent.slice(0, count - told)));
  told = count;
  const table = byId("events");
  table.hidden = now.repeated.length === 0;
  table.tBodies[0].replaceChildren(...now.repeated.map((event) => make("tr", {},
    make("td", { class: "n" }, `${shown(event.time_s, 1)} s`),
    make("td", { class: "n" }, event.count > 1 ? `${whole(event.count)} × since ${shown(event.first_s, 1)} s` : ""),
    make("td", {}, event.sensor || "array"),
    make("td", event.trouble ? { class: "warn" } : {}, `${event.trouble ? "▲ " : ""}${event.kind}`), make("td", {}, event.message))));
}

const LEVELS = { green: "Healthy:", amber: "Attention:", red: "Trouble:" };

function health(now) {
  const box = byId("health");
  box.hidden = !now.health;
  if (!now.health) return;
  box.dataset.level = now.health.level;
  write(byId("health-level"), LEVELS[now.health.level]);
  write(byId("health-reason"), `${now.health.reason}.${now.health.advice ? ` To do: ${now.health.advice}.` : ""}`);
}

const STATES = {
  "being written": "being written", finished: "the log has ended", interrupted: "interrupted: no program writes it any more",
  waiting: "waiting for the log",
};

function show(now) {
  byId("state").dataset.state = now.state;
  write(byId("state-text"), STATES[now.state] ?? now.state);
  write(byId("log"), now.log);
  document.title = `${now.log}: ${now.state}`;
  byId("remark").hidden = !now.remark;
  write(byId("remark"), now.remark);
  health(now);
  const whatIs = now.begins_s !== null;
  byId("main").hidden = !whatIs;
  if (!whatIs) {
    write(byId("about"), "Nothing has been recorded yet; the page shows the log as soon as it has rows.");
    return;
  }
  write(byId("about"), `${now.source}, time 0 is ${now.epoch}`);
  tiles(now);
  fused(now);
  events(now);
  sensors(now);
  write(byId("foot"), `imuarray monitor; curves show the smallest and the largest value of short stretches of the last seconds.`);
}

// ---- asking --------------------------------------------------------------------------------------------------------

let failures = 0;
let timer = 0;

async function ask() {
  clearTimeout(timer);
  let wait = everyMs;
  try {
    const answer = await fetch(`snapshot.json${query}`, { signal: AbortSignal.timeout(15000) });
    if (!answer.ok) throw new Error(await answer.text());
    const now = await answer.json();
    failures = 0;
    byId("connection").hidden = true;
    show(now);
    if (now.state === "finished" || now.state === "interrupted") wait = ENDED_MS;
    if (document.hidden) wait = Math.max(wait, 5 * everyMs);
  } catch (error) {
    wait = Math.min(LONGEST_WAIT_MS, everyMs * 2 ** failures++);
    byId("connection").hidden = false;
    byId("state").dataset.state = "lost";
    write(byId("state-text"), "no connection");
    write(byId("connection"), `The monitor does not answer; the page shows old data. It tries again in ${duration(wait / 1e3)}.`);
    console.warn(error);
  }
  timer = setTimeout(ask, wait);
}
document.addEventListener("visibilitychange", () => { if (!document.hidden) ask(); });
ask();
