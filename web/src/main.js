// The page: the scene, the query box with its results, the time line, and facts about an entity.

import { Connection } from "./connection.js";
import { Editor } from "./editor.js";
import { element, pressable } from "./elements.js";
import { EntityPanel } from "./entity.js";
import { Scene } from "./scene.js";
import { Timeline } from "./timeline.js";
import { Tracks } from "./tracks.js";

const at = (id) => document.getElementById(id);
const nonce = at("program").dataset.nonce;
const AGAIN_MS = 250;
// How much farther right the parts of a condition are, pixels.
const INDENT = 16;

const state = {
  hello: null, language: "selectscript", status: null, time: 0, tick: 0, question: null,
  answer: null, sorted: null, isReplaying: false, isSeeking: false, wanted: null, track: null, scan: 0,
};
window.__ss = { ready: false, answers: 0, updates: 0, connected: false, error: null, scans: 0, highlighted: 0 };

const scene = new Scene(at("stage"), (entity) => pick(entity));
const editor = new Editor(at("editor"), nonce, { run: () => run(), complete });
const timeline = new Timeline(
  {
    slider: at("slider"), lanes: at("lanes"), previous: at("previous"), next: at("next"), live: at("live"),
  },
  { seek: (index) => goTo(index), live: () => goLive() },
);
const tracks = new Tracks(askForTrack);
const panel = new EntityPanel(at("entity"), {
  pick: (name) => pick(name === null ? null : (scene.head.entities.find((each) => each.name === name)?.id ?? null)),
  mark: (links) => scene.mark(links, []),
  plot: (question) => connection.ask({ type: "plot", ...question }),
  go: (time) => timeline.go(timeline.indexAt(time)),
});
const connection = new Connection({ hello, scene: show, poses: move, status, ticks, lost, scan: scanned });

// -- the world

function hello(message) {
  const isAgain = state.hello !== null;
  state.hello = message;
  window.__ss.connected = true;
  at("lost").hidden = true;
  at("world").textContent = message.world;
  document.title = `${message.world} · ssduck`;
  const isRecord = message.kind === "record";
  at("kind").textContent = isRecord ? "recorded" : "live";
  timeline.isLive = !isRecord;
  if (!isAgain) timeline.isFollowing = !isRecord;
  tracks.clear();
  state.track = null;
  Object.assign(state, { isSeeking: false, wanted: null });
  showPlaying();
  if (!editor.text) editor.text = `SELECT id(this) FROM ${message.world} WHERE isRobot(this);`;
  timeline.show();
}

function show(head) {
  scene.show(head);
  tracks.clear();
  state.track = null;
  if (state.answer) highlight(state.answer);
}

function ticks(message) {
  const dropped = timeline.setTicks(message);
  if (message.anew) tracks.clear();
  else if (dropped) tracks.shift(dropped);
  window.__ss.ticks = timeline.times.length;
  at("overTime").hidden = !state.answer || timeline.times.length < 2;
}

// Poses from the server: of the present, or of a tick whose track is not here.
function move(rows, poses, time, tick) {
  state.isSeeking = false;
  if (!timeline.isFollowing && timeline.isLive && time > timeline.time + 1e-9 && window.__ss.ready) {
    if (state.wanted !== null) goTo(state.wanted);
    return;
  }
  scene.move(rows, poses);
  state.track = null;
  state.tick = tick;
  window.__ss.updates += 1;
  seen(time, `${time.toFixed(3)} s · tick ${tick}`);
  if (state.wanted !== null) goTo(state.wanted);
  else if (!timeline.isFollowing && timeline.times.length && Math.abs(timeline.time - time) > 1e-9) goTo(timeline.index);
}

function seen(time, text) {
  state.time = time;
  at("time").textContent = text;
  panel.setTime(time);
  window.__ss.ready = true;
  window.__ss.time = time;
  if (state.answer?.drawing?.kind === "why") drawReasons(state.answer);
  askAgain();
}

function status(message) {
  state.status = message;
  showPlaying();
  if (timeline.isFollowing) at("speed").value = String(message.speed);
  if (message.error) showError({ message: message.error, suggestions: [] });
}

function lost() {
  window.__ss.connected = window.__ss.ready = false;
  at("lost").hidden = false;
}

// -- time

async function askForTrack(first, count) {
  const answer = await connection.ask({ type: "track", first, count });
  return answer.none ? null : answer;
}

// Shows a recorded tick: from its track if that is here, else from the server.
function goTo(index) {
  showPlaying();
  const time = timeline.times[index];
  const track = tracks.at(index);
  if (track && !track.isRemote) {
    if (!state.isLocal) connection.send({ type: "seek", at: time, local: true });
    Object.assign(state, { isLocal: true, wanted: null });
    scene.showTrack(track, index, state.track !== track);
    state.track = track;
    window.__ss.local = (window.__ss.local ?? 0) + 1;
    seen(time, `${time.toFixed(3)} s · tick ${timeline.numbers[index]} (${index + 1} of ${timeline.times.length})`);
    prefetch(index, track);
    return;
  }
  if (!track) {
    const isBackwards = time < state.time;
    tracks.load(index, isBackwards).then((loaded) => {
      if (loaded && !timeline.isFollowing) goTo(timeline.index);
    });
  }
  state.wanted = index;
  if (state.isSeeking) return;
  state.wanted = null;
  state.isLocal = false;
  if (time === state.time && window.__ss.ready && !state.track) return;
  state.isSeeking = true;
  connection.send({ type: "seek", at: time });
}

// The next track is asked for before it is needed.
function prefetch(index, track) {
  const next = track.first + track.count;
  if (next - index < track.count / 3 && next < timeline.times.length && !tracks.at(next)) tracks.load(next + 32, false);
}

function goLive() {
  stopReplay();
  Object.assign(state, { isLocal: false, isSeeking: false, wanted: null, track: null });
  connection.send({ type: "seek", at: null });
}

let played = null;
function playOn(now) {
  if (!state.isReplaying) return;
  const { times } = timeline;
  const start = (played ??= { now, time: timeline.time });
  const wanted = start.time + ((now - start.now) / 1000) * Number(at("speed").value);
  const index = Math.max(timeline.index, timeline.indexAt(wanted));
  if (index !== timeline.index) {
    timeline.go(index);
    state.isReplaying = true;
  }
  if (index === times.length - 1) stopReplay();
  else requestAnimationFrame(playOn);
}

function stopReplay() {
  state.isReplaying = false;
  showPlaying();
}

function play() {
  if (timeline.isFollowing) {
    connection.ask({ type: "control", action: state.status?.playing ? "pause" : "play" }).catch(() => {});
    return;
  }
  state.isReplaying = !state.isReplaying;
  if (state.isReplaying && timeline.index === timeline.times.length - 1) timeline.go(0);
  played = null;
  showPlaying();
  requestAnimationFrame(playOn);
}

function showPlaying() {
  // A world that is stepped elsewhere is not played, but its recorded ticks are.
  const isPlayed = !timeline.isFollowing || state.hello?.controls;
  for (const id of ["play", "step", "reset", "speed"]) at(id).hidden = !isPlayed;
  const isPlaying = timeline.isFollowing ? state.status?.playing : state.isReplaying;
  const path = isPlaying ? "M3 2 H6.5 V14 H3 Z M9.5 2 H13 V14 H9.5 Z" : "M4 2 L13 8 L4 14 Z";
  at("play").querySelector("path").setAttribute("d", path);
}

function control(action, value) {
  if (!timeline.isFollowing) {
    if (action === "step") timeline.go(timeline.index + 1);
    if (action === "reset") timeline.go(0);
    if (action === "speed") played = null;
    return;
  }
  connection.ask({ type: "control", action, value }).catch(() => {});
}

at("play").onclick = play;
at("step").onclick = () => control("step", 1);
at("reset").onclick = () => {
  if (state.hello?.controls) timeline.follow();
  control("reset");
};
at("speed").onchange = () => control("speed", Number(at("speed").value));
at("slider").addEventListener("pointerdown", stopReplay);
document.addEventListener("keydown", (event) => {
  if (event.target !== document.body) return;
  if (event.key === " ") {
    event.preventDefault();
    play();
  } else if (event.key === "ArrowRight" || event.key === "ArrowLeft") {
    timeline.go(timeline.index + (event.key === "ArrowRight" ? 1 : -1));
  }
});

// -- queries

function timeAsked() {
  return timeline.isFollowing || !timeline.times.length ? {} : { at: timeline.time };
}

async function complete(text, cursor) {
  try {
    const answer = await connection.ask({ type: "complete", text, cursor, language: state.language });
    return answer.completions ?? [];
  } catch {
    return [];
  }
}

// What the result has stands out, and is drawn where it is.
function highlight(answer) {
  scene.mark(answer.all, answer.lines, answer.boxes);
  if (answer.drawing?.kind === "why") drawReasons(answer);
  else scene.draw3d(answer.drawing);
}

// Draws the parts of a condition that are of the tick that is seen.
function drawReasons(answer) {
  const isSeen = (time) => Math.abs((time ?? answer.asked) - state.time) < 1e-9;
  const parts = answer.drawing.parts.filter(
    ({ points, time }) => points.length && (isSeen(time) || (time === null && timeline.isFollowing)),
  );
  scene.draw3d({ kind: "why", parts });
}

// Goes to the tick that decides; the answer is of that tick until another one is looked at.
function goToDecision(answer) {
  if (answer.decided === null || !timeline.times.length) return;
  stopReplay();
  const index = timeline.indexAt(answer.decided);
  answer.time = timeline.times[index];
  timeline.go(index);
}

// Looks for the ticks at which the answer changes.
function scan() {
  if (!state.question || timeline.times.length < 2) return;
  state.scan += 1;
  at("overTime").textContent = "looking …";
  connection.send({ type: "scan", id: `scan ${state.scan}`, ...state.question });
}

function scanned(message) {
  if (message.id !== `scan ${state.scan}`) return;
  if (message.error) {
    at("overTime").textContent = "over time";
    timeline.setRuns([]);
    if (!state.answer) showError(message.error);
    return;
  }
  timeline.setRuns(message.runs);
  at("overTime").textContent = message.done ? "over time" : `looking … ${Math.round(100 * message.share)} %`;
  if (message.done) window.__ss.scans += 1;
}

async function run() {
  const text = editor.text.trim() ? editor.text : "";
  if (!text) return;
  editor.remember(text);
  state.question = { text, language: state.language };
  state.sorted = null;
  timeline.setRuns([]);
  timeline.setSpans([]);
  state.scan += 1;
  await ask(true);
  // What is drawn, or says itself when something held, is looked for only if asked.
  const { answer } = state;
  if (answer && state.hello.kind === "record" && !answer.picture && !answer.lanes.length) scan();
}

let isAsking = false;
let lastAsked = 0;
let asked = 0;
async function ask(isNew) {
  const question = state.question;
  const number = (asked += 1);
  isAsking = true;
  lastAsked = performance.now();
  try {
    const answer = await connection.ask({ type: "ask", anew: isNew, ...question, ...timeAsked() });
    // The server ends a query when another one is asked.
    if (question !== state.question || number !== asked) return;
    if (answer.error) {
      state.answer = null;
      if (!isNew) state.question = null;
      highlight({ all: [], lines: [], boxes: [] });
      showError(answer.error);
    } else {
      state.answer = answer;
      answer.asked = answer.time;
      highlight(answer);
      timeline.setSpans(answer.lanes);
      showAnswer();
      if (isNew) goToDecision(answer);
    }
    window.__ss.error = answer.error ?? null;
    window.__ss.answers += 1;
    const began = lastAsked;
    scene.afterDrawing(() => (window.__ss.highlighted = performance.now() - began));
  } catch (error) {
    showError({ message: error.message, suggestions: [] });
  } finally {
    if (number === asked) isAsking = false;
  }
}

let timer = null;
function askAgain() {
  if (!state.answer || !state.question || !at("again").querySelector("input").checked) return;
  if (state.answer.time === state.time || isAsking || timer) return;
  const wait = Math.max(0, lastAsked + AGAIN_MS - performance.now());
  timer = setTimeout(() => {
    timer = null;
    if (!isAsking && state.question && state.answer) ask(false);
  }, wait);
}

function showError(error) {
  const box = at("error");
  box.replaceChildren(error.message);
  box.className = "";
  box.hidden = false;
  editor.showError(error);
  if (error.line && state.question) {
    const line = state.question.text.split("\n")[error.line - 1] ?? "";
    const width = Math.max(1, Math.min(error.end - error.start, line.length - error.column + 1));
    const pre = document.createElement("pre");
    pre.textContent = `${line}\n${" ".repeat(error.column - 1)}${"^".repeat(width)}`;
    box.append(pre);
    // The marks are seen, however long the line is.
    pre.scrollLeft = Math.max(0, ((error.column + width) / line.length) * pre.scrollWidth - pre.clientWidth);
  }
  for (const name of error.suggestions) {
    const button = element("button", name);
    button.onclick = () => {
      if (error.start === null) return;
      const found = editor.text.slice(error.start, error.end);
      const quote = /^['"]/.test(found) ? found[0] : "";
      const owner = !quote && found.includes(".") ? found.slice(0, found.lastIndexOf(".") + 1) : "";
      editor.replace(error.start, error.end, quote + owner + name + quote);
      run();
    };
    box.append(button);
  }
  at("result").replaceChildren();
  at("count").textContent = "";
  at("downloads").hidden = true;
}

function showAnswer() {
  const { answer } = state;
  editor.showError(null);
  at("error").hidden = !answer.warnings.length;
  at("error").className = "note";
  at("error").replaceChildren(answer.warnings.join("\n"));
  const shown = answer.rows.length < answer.count ? ` (${answer.rows.length} shown)` : "";
  const rows = answer.picture ? "a picture" : `${answer.count} ${answer.count === 1 ? "row" : "rows"}${shown}`;
  at("count").textContent = `${rows} · ${answer.ms.toFixed(1)} ms · at ${answer.time.toFixed(3)} s`;
  at("downloads").hidden = false;
  at("overTime").hidden = timeline.times.length < 2;
  for (const button of at("downloads").querySelectorAll("[data-format]")) button.hidden = !!answer.picture;
  if (answer.picture) {
    const image = new Image();
    image.src = `data:image/png;base64,${answer.picture}`;
    at("result").replaceChildren(image);
    return;
  }
  at("result").replaceChildren(tableOf(answer));
}

function tableOf(answer) {
  const table = element("table");
  const parts = answer.drawing?.kind === "why" ? answer.drawing.parts : null;
  if (parts) table.className = "why";
  const head = table.createTHead().insertRow();
  answer.columns.forEach((name, column) => {
    const isSorted = state.sorted?.column === column;
    const cell = element("th", name + (isSorted ? (state.sorted.isUp ? " ▴" : " ▾") : ""));
    if (answer.numeric[column]) cell.className = "number";
    pressable(cell, () => {
      state.sorted = { column, isUp: !(isSorted && state.sorted.isUp) };
      showAnswer();
      at("result").querySelectorAll("th")[column].focus();
    });
    head.append(cell);
  });
  const order = answer.rows.map((_, index) => index);
  if (state.sorted) {
    const { column, isUp } = state.sorted;
    const values = answer.rows.map((row) => (answer.numeric[column] ? numberOf(row[column]) : row[column]));
    order.sort((a, b) => compare(values[a], values[b], isUp ? 1 : -1));
  }
  const body = table.createTBody();
  for (const index of order) {
    const row = body.insertRow();
    answer.rows[index].forEach((value, column) => {
      const cell = row.insertCell();
      cell.textContent = cell.title = textOf(value);
      cell.classList.toggle("number", answer.numeric[column]);
      cell.classList.toggle("null", value === null);
    });
    if (parts) row.cells[0].style.paddingLeft = `${8 + INDENT * parts[index].depth}px`;
    const marks = answer.marks[index];
    if (!marks.length) continue;
    row.className = "marked";
    pressable(row, () => {
      for (const other of body.rows) other.classList.remove("chosen");
      row.classList.add("chosen");
      scene.mark(marks, [], answer.boxes.filter(([entity]) => marks.some((mark) => mark[0] === entity)));
      pick(marks[0][0]);
    });
  }
  return table;
}

// Numbers that a double or JSON lacks come as texts: long integers, inf, -inf and nan.
function numberOf(value) {
  if (typeof value !== "string") return value;
  return /^-?\d+$/.test(value) ? BigInt(value) : Number(value.replace("inf", "Infinity"));
}

// As in DuckDB, NaN is greater than infinity, and NULL comes last in either order.
function compare(a, b, sign) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a === "string" || typeof b === "string") {
    return sign * textOf(a).localeCompare(textOf(b), undefined, { numeric: true });
  }
  return sign * (a < b ? -1 : a > b ? 1 : Number.isNaN(a) - Number.isNaN(b));
}

function textOf(value) {
  if (value === null) return "NULL";
  if (typeof value !== "number" || Number.isInteger(value)) return String(value);
  return String(Number(value.toPrecision(Math.abs(value) < 1e6 ? 6 : 15)));
}

at("run").onclick = run;
at("overTime").onclick = scan;
at("clear").onclick = () => {
  state.question = state.answer = null;
  state.scan += 1;
  timeline.setRuns([]);
  timeline.setSpans([]);
  highlight({ all: [], lines: [], boxes: [] });
  at("result").replaceChildren();
  at("count").textContent = "";
  at("downloads").hidden = true;
};
for (const button of at("languages").children) {
  button.onclick = () => {
    state.language = button.dataset.language;
    for (const each of at("languages").children) each.setAttribute("aria-pressed", each === button);
    editor.setLanguage(state.language);
  };
}
for (const button of at("downloads").querySelectorAll("[data-format]")) {
  button.onclick = async () => {
    const answer = await connection.ask({ type: "download", format: button.dataset.format });
    if (answer.error) return showError(answer.error);
    const bytes = Uint8Array.from(atob(answer.content), (letter) => letter.charCodeAt(0));
    const link = element("a");
    link.href = URL.createObjectURL(new Blob([bytes]));
    link.download = answer.name;
    link.click();
    URL.revokeObjectURL(link.href);
  };
}

// -- an entity

async function pick(entity) {
  scene.select(entity);
  window.__ss.picked = null;
  state.picked = entity;
  if (entity === null) {
    panel.hide();
    return;
  }
  let answer;
  try {
    answer = await connection.ask({ type: "pick", entity, ...timeAsked() });
  } catch {
    return;
  }
  if (state.picked !== entity) return;
  if (answer.error) return showError(answer.error);
  panel.show(entity, answer, state.time);
  window.__ss.picked = answer.name;
}

// What tests wait on and look at.
Object.defineProperties(window.__ss, Object.getOwnPropertyDescriptors({
  poseOf: (name) => scene.poseOf(name),
  placeOf: (name) => scene.placeOf(name),
  type: (text) => (editor.text = text),
  run,
  seek: (index) => timeline.go(index),
  get index() {
    return timeline.index;
  },
  get changes() {
    return timeline.changes;
  },
  get lanes() {
    return timeline.lanes.map(({ label, bars }) => [label, bars.map(({ start, end }) => [start, end])]);
  },
  get drawings() {
    return scene.drawn.children.length;
  },
  drop: () => connection.socket.close(),
  get frames() {
    return scene.framesDrawn;
  },
}));
