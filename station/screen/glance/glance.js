// Draws what station/screen/glance_feed.py says, and how old it is. Asks for nothing but the stream of values.
"use strict";

const STALE_S = 1.0;       // older values are greyed
const REOPEN_MS = 3000;    // a connection that has said nothing for so long is opened anew
const STRIP_S = 60;
const DRIFT = 1e-4;        // the most that this device's clock gains on the station's
const REPEAT_MS = 10000;   // between calls for an alarm that still stands

const $ = (id) => document.getElementById(id);
let source = null, last = null, ended = false;
let heardMs = 0, spokeMs = 0, ageAtHeard = Infinity, floor = null, sentS = -Infinity, flight = null;
let strip = [], alarmKeys = new Set(), calledMs = -Infinity, wasStale = true, sound = null;

// --- what is heard, and its age ---------------------------------------------------------------------------------

function open_() {
  if (source) source.close();
  spokeMs = performance.now();
  source = new EventSource("live");
  source.onopen = () => { spokeMs = performance.now(); };
  source.onmessage = (event) => take(JSON.parse(event.data));
  source.addEventListener("ended", () => { ended = true; source.close(); source = null; age(); });
}

function take(message) {
  const now = performance.now(), shown = message.shown;
  if (shown.flight !== flight || shown.sent_s < sentS) { flight = shown.flight; floor = null; strip = []; }
  sentS = shown.sent_s;
  // What a slow network holds back is older than what it lets through at once: the least delay seen is taken for none.
  const offset = now / 1000 - shown.sent_s;
  floor = floor === null ? offset : Math.min(floor + DRIFT * (now - heardMs) / 1000, offset);
  ageAtHeard = offset - floor + message.held_s + (shown.age_s === null ? Infinity : shown.age_s);
  heardMs = spokeMs = now;
  ended = false;
  last = shown;
  draw(shown, now);
  age();
}

function ageS() { return last ? ageAtHeard + (performance.now() - heardMs) / 1000 : Infinity; }

function age() {
  const seconds = ageS(), stale = ended || !(seconds <= STALE_S);
  const silent = (performance.now() - heardMs) / 1000 > STALE_S;
  document.body.classList.toggle("stale", stale);
  document.body.classList.toggle("ended", ended);
  const words = !Number.isFinite(seconds) ? "no values yet" : `${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s old`;
  text($("age"), stale ? words : "live");
  text($("lost-words"), ended ? "FLIGHT ENDED" : !last ? "NO CONNECTION" : silent ? "CONNECTION LOST" : !last.age_s && last.age_s !== 0 ? "NO DATA YET" : "STATION STALLED");
  text($("lost-age"), last && Number.isFinite(seconds) ? `what is shown is ${words}` : words);
  if (stale && !wasStale && !ended) call(330, 3);
  wasStale = stale;
}

setInterval(() => {
  if (!ended && (!source || source.readyState === EventSource.CLOSED || performance.now() - spokeMs > REOPEN_MS)) open_();
  age();
  if (standing() && performance.now() - calledMs > REPEAT_MS) call(880, 3);
}, 200);
document.addEventListener("visibilitychange", age);

// --- sound --------------------------------------------------------------------------------------------------------

$("sound").onclick = () => {
  if (sound) { sound.close(); sound = null; } else { sound = new AudioContext(); call(660, 1); keepAwake(); }
  $("sound").classList.toggle("on", !!sound);
  text($("sound"), sound ? "Sound on" : "Sound off: tap");
};

function call(hertz, times) {
  calledMs = performance.now();
  if (!sound) return;
  for (let i = 0; i < times; i++) {
    const tone = sound.createOscillator(), loudness = sound.createGain(), at = sound.currentTime + 0.28 * i;
    tone.type = "square";
    tone.frequency.value = hertz;
    loudness.gain.setValueAtTime(0.25, at);
    loudness.gain.setTargetAtTime(0, at + 0.15, 0.02);
    tone.connect(loudness).connect(sound.destination);
    tone.start(at);
    tone.stop(at + 0.27);
  }
}

function standing() { return alarmKeys.size > 0 && !wasStale; }

function keepAwake() {  // only over https or on this machine does a browser have it
  if (navigator.wakeLock) navigator.wakeLock.request("screen").catch(() => {});
}

// --- drawing --------------------------------------------------------------------------------------------------------

function text(element, words) { if (element.textContent !== words) element.textContent = words; }

function made(tag, className, words) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (words !== undefined) element.textContent = words;
  return element;
}

/** Replaces an element's content, but only if it changed: a list that is being scrolled stays where it is. */
function fill(element, content, build) {
  const key = JSON.stringify(content);
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.replaceChildren(...content.map(build));
}

function draw(s, now) {
  text($("title"), s.title);
  document.title = `${s.alarms.length ? `(${s.alarms.length}) ` : ""}${s.title}`;
  text($("elapsed"), s.elapsed);
  $("point").hidden = !s.test_point;
  if (s.test_point) text($("point"), `TEST POINT ${s.test_point.number} · ${Math.max(0, s.test_point.since_s).toFixed(0)} s`);
  for (const [name, answer] of Object.entries(s.answers)) {
    const card = $(`answer-${name}`);
    card.className = answer.state;
    text(card.querySelector(".words"), answer.words);
    text(card.querySelector(".why"), answer.why);
  }
  drawAlarms(s);
  drawAlpha(s, now);
  drawStep(s.step);
  text($("method"), `by ${s.method}`);
  fill($("longitudinal"), s.derivatives, derivative);
  $("lateral-part").hidden = !s.lateral.length;
  const sure = s.lateral.filter((d) => d.bound).length;
  text($("lateral-head"), `Lateral, by ${s.lateral_method}: ${sure} of ${s.lateral.length} estimated`);
  fill($("lateral"), s.lateral, derivative);
  const events = s.events.length ? s.events : [{ at: "", level: "", text: "none" }];
  fill($("event-list"), events, (event) => {
    const line = made("li", event.level);
    line.append(made("time", "", event.at), event.text);
    return line;
  });
  const poor = s.links.poor.length ? `not alive: ${s.links.poor.join(", ")}` : "";
  text($("links"), [`links ${s.links.alive}/${s.links.of} alive`, poor, s.losses].filter(Boolean).join("; "));
}

function drawAlarms(s) {
  const shown = [...s.alarms.map((e) => ({ kind: "alarm", e })), ...s.checks.map((e) => ({ kind: "check", e }))];
  $("alarms").hidden = !shown.length;
  fill($("alarms"), shown, ({ kind, e }) => made("p", kind, `${kind === "alarm" ? "ALARM" : "CHECK"}  ${e.at}  ${e.text}`));
  const keys = new Set(s.alarms.map((e) => e.at + e.text));
  if ([...keys].some((key) => !alarmKeys.has(key))) call(880, 3);
  alarmKeys = keys;
}

function drawAlpha(s, now) {
  const a = s.alpha, giant = document.querySelector(".giant");
  giant.className = `giant ${s.answers.alpha.state}`;
  const [value, bound] = a ? a.text.replace("( ", "(").split(" ± ") : ["–", ""];
  text($("alpha-value"), value);
  text($("alpha-bound"), bound ? `± ${bound}` : "");
  text($("air"), a ? `turbulence ${a.air}` : "");
  if (s.age_s < STALE_S) strip.push({ t: now / 1000, a });
  while (strip.length && strip[0].t < now / 1000 - STRIP_S) strip.shift();
  drawStrip(now / 1000);
}

function drawStep(step) {
  $("step").hidden = !step;
  if (!step) return;
  const run = step.run ? `, run ${step.run} of ${step.runs}` : "";
  text($("step-head"), `Step ${step.number}/${step.of}: ${step.name}${run}${step.configuration ? ` – ${step.configuration}` : ""}`);
  text($("step-words"), step.words);
  $("step-words").className = step.phase;
  fill($("checks"), step.checks, (check) => made("span", check.good ? "" : "amiss", check.words));
  $("verdict").hidden = !step.verdict;
  if (step.verdict) { text($("verdict"), step.verdict.words); $("verdict").className = step.verdict.kind; }
  fill($("results"), step.results, (result) => {
    const line = made("li", "", `${result.name}: `);
    line.append(made("b", result.ended, result.ended));
    return line;
  });
  fill($("inputs"), step.inputs.map((input) => input.surface), () => made("canvas"));
  step.inputs.forEach((input, k) => drawInput($("inputs").children[k], input, step));
}

function derivative(d) {
  const line = made("div", `derivative ${d.state}`);
  line.append(made("span", "name", d.name), made("span", "value", d.value), made("span", "bound", d.bound));
  const share = (x) => (x >= 0.995 ? Math.round(100 * x) : +(100 * x).toPrecision(2));
  const wanted = d.wanted ? ` / ${share(d.wanted)} %` : " %";
  const known = d.have === null ? d.state : share(d.have) + wanted;
  const second = made("div", "second");
  if (d.wanted) {  // the bar is 2σ; the mark, where it must have come down to
    const bar = made("div", "bar"), length = made("i"), mark = made("b");
    length.style.width = `${d.have === null ? 0 : Math.min(100, 100 * d.have / (3 * d.wanted))}%`;
    mark.style.left = "33.3%";
    bar.append(length, mark);
    second.append(bar);
  }
  second.append(made("span", "state", d.state === "enough" ? `enough: ${known}` : known));
  if (d.change) second.append(made("span", "change", `${d.change} of the baseline`));
  line.append(second);
  if (d.why && d.state !== "unestimated") line.append(made("span", "why", d.why));
  return line;
}

function colour(name) { return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim(); }

/** A canvas as sharp as the screen: its pen, width and height in CSS pixels. */
function pen(canvas) {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const p = canvas.getContext("2d");
  p.setTransform(scale, 0, 0, scale, 0, 0);
  p.clearRect(0, 0, width, height);
  p.font = "13px system-ui, sans-serif";
  return [p, width, height];
}

function drawStrip(now) {
  const [p, width, height] = pen($("strip"));
  const seen = strip.filter((x) => x.a && Number.isFinite(x.a.value) && Number.isFinite(x.a.bound));
  if (!seen.length) return;
  const sure = seen.filter((x) => x.a.valid), scaled = sure.length ? sure : seen;
  let low = Math.min(...scaled.map((x) => Math.min(x.a.value - x.a.bound, x.a.vane ?? Infinity)));
  let high = Math.max(...scaled.map((x) => Math.max(x.a.value + x.a.bound, x.a.vane ?? -Infinity)));
  const room = Math.max(0.1 * (high - low), 0.25);
  low -= room; high += room;
  const left = 44, x = (t) => left + (width - left) * (1 - (now - t) / STRIP_S);
  const y = (v) => height * (high - v) / (high - low);
  const step = [0.5, 1, 2, 5, 10, 20].find((d) => (high - low) / d <= 5) ?? 50;
  p.lineWidth = 1;
  for (let v = Math.ceil(low / step) * step; v < high; v += step) {
    p.strokeStyle = colour("line");
    p.beginPath(); p.moveTo(left, y(v)); p.lineTo(width, y(v)); p.stroke();
    p.fillStyle = colour("dim");
    p.fillText(`${v.toFixed(step < 1 ? 1 : 0)}°`, 2, y(v) + 4);
  }
  line(p, seen, (e) => [x(e.t), y(e.a.vane)], colour("vane"), 1.2, () => true);
  p.fillStyle = colour("good");
  p.globalAlpha = 0.28;
  for (const part of parts(seen, (e) => e.a.valid)) {
    p.beginPath();
    part.forEach((e) => p.lineTo(x(e.t), y(e.a.value + e.a.bound)));
    [...part].reverse().forEach((e) => p.lineTo(x(e.t), y(e.a.value - e.a.bound)));
    p.fill();
  }
  p.globalAlpha = 1;
  line(p, seen, (e) => [x(e.t), y(e.a.value)], colour("good"), 2.5, (e) => e.a.valid);
}

/** Runs of what belongs together: a gap of half a second, or what is not to be believed, ends one. */
function parts(points, belongs) {
  const found = [];
  let part = [];
  for (const point of points) {
    if (!belongs(point) || (part.length && point.t - part[part.length - 1].t > 0.5)) { if (part.length) found.push(part); part = []; }
    if (belongs(point)) part.push(point);
  }
  if (part.length) found.push(part);
  return found;
}

function line(p, points, place, style, thick, belongs) {
  p.strokeStyle = style;
  p.lineWidth = thick;
  for (const part of parts(points, belongs)) {
    p.beginPath();
    part.forEach((point) => p.lineTo(...place(point)));
    p.stroke();
  }
}

function drawInput(canvas, input, step) {
  const [p, width, height] = pen(canvas), n = input.drawn.length;
  const peak = Math.max(0.5, ...input.drawn.map(Math.abs), ...input.flown.map(Math.abs)) * 1.15;
  const left = 76, x = (k) => left + (width - left) * k / Math.max(1, n - 1), y = (v) => height / 2 * (1 - v / peak);
  p.fillStyle = colour("dim");
  p.fillText(input.surface, 2, height / 2 + 4);
  p.fillText(`${(+peak).toFixed(1)}°`, 2, 12);
  p.fillText(`${(-peak).toFixed(1)}°`, 2, height - 3);
  const drawing = (values, style, thick) => {
    p.strokeStyle = style; p.lineWidth = thick; p.beginPath();
    values.forEach((v, k) => { if (v !== null) p.lineTo(x(k), y(v)); });
    p.stroke();
  };
  drawing(input.drawn, colour("none"), 5);
  drawing(input.flown, colour("doubt"), 2.5);
  if (step.phase === "flying") {
    const at = left + (width - left) * Math.min(1, step.since_s / input.duration_s);
    p.strokeStyle = colour("ink"); p.lineWidth = 2;
    p.beginPath(); p.moveTo(at, 0); p.lineTo(at, height); p.stroke();
  }
}

open_();
