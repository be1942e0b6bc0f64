// The page: the scene, the query box with its results, the time line, and facts about an entity.

import { Connection } from "./connection.js";
import { Editor } from "./editor.js";
import { Scene } from "./scene.js";

const at = (id) => document.getElementById(id);
const nonce = at("program").dataset.nonce;
const AGAIN_MS = 250;

const state = {
  hello: null, language: "selectscript", status: null, time: 0, tick: 0, question: null,
  answer: null, sorted: null, index: 0, isPlaying: false, isSeeking: false, wanted: null,
};
window.__ss = { ready: false, answers: 0, updates: 0, connected: false, error: null };

const scene = new Scene(at("stage"), (entity) => pick(entity));
const editor = new Editor(at("editor"), nonce, { run: () => run(), complete });
const connection = new Connection({ hello, scene: show, poses: move, status, lost });

// -- the world

function hello(message) {
  state.hello = message;
  window.__ss.connected = true;
  at("lost").hidden = true;
  at("world").textContent = message.world;
  document.title = `${message.world} · ssduck`;
  const isRecord = message.kind === "record";
  at("kind").textContent = isRecord ? "recorded" : "live";
  const isControlled = isRecord || message.controls;
  for (const id of ["play", "step", "reset", "speed"]) at(id).hidden = !isControlled;
  at("slider").disabled = !isRecord;
  if (isRecord) {
    at("slider").max = message.times.length - 1;
    seek(Math.min(state.index, message.times.length - 1));
  }
  if (!editor.text) editor.text = `SELECT id(this) FROM ${message.world} WHERE isRobot(this);`;
}

function show(head) {
  scene.show(head);
  if (state.answer) scene.mark(state.answer.all, state.answer.lines, state.answer.boxes);
}

function move(rows, poses, time, tick) {
  scene.move(rows, poses);
  Object.assign(state, { time, tick, isSeeking: false });
  at("time").textContent = `${time.toFixed(3)} s · tick ${tick}`;
  window.__ss.ready = true;
  window.__ss.updates += 1;
  window.__ss.time = time;
  if (state.wanted !== null) seek(state.wanted);
  askAgain();
}

function status(message) {
  state.status = message;
  state.isPlaying = message.playing;
  showPlaying();
  at("speed").value = String(message.speed);
  if (message.error) showError({ message: message.error, suggestions: [] });
}

function lost() {
  window.__ss.connected = window.__ss.ready = false;
  at("lost").hidden = false;
}

// -- time

function seek(index) {
  state.wanted = index;
  at("slider").value = index;
  if (state.isSeeking) return;
  state.wanted = null;
  state.index = index;
  const time = state.hello.times[index];
  if (time === state.time && window.__ss.ready) return;
  state.isSeeking = true;
  connection.send({ type: "seek", at: time });
}

let played = null;
function playOn(now) {
  if (!state.isPlaying || state.hello.kind !== "record") return;
  const times = state.hello.times;
  const start = (played ??= { now, time: times[state.index] });
  const wanted = start.time + ((now - start.now) / 1000) * Number(at("speed").value);
  let index = state.index;
  while (index < times.length - 1 && times[index + 1] <= wanted) index += 1;
  if (index !== state.index && !state.isSeeking) seek(index);
  if (index === times.length - 1) state.isPlaying = false;
  showPlaying();
  requestAnimationFrame(playOn);
}

function play() {
  if (state.hello?.kind !== "record") {
    connection.ask({ type: "control", action: state.isPlaying ? "pause" : "play" }).catch(() => {});
    return;
  }
  state.isPlaying = !state.isPlaying;
  if (state.isPlaying && state.index === state.hello.times.length - 1) seek(0);
  played = null;
  showPlaying();
  requestAnimationFrame(playOn);
}

function showPlaying() {
  const path = state.isPlaying ? "M3 2 H6.5 V14 H3 Z M9.5 2 H13 V14 H9.5 Z" : "M4 2 L13 8 L4 14 Z";
  at("play").querySelector("path").setAttribute("d", path);
}

function control(action, value) {
  if (state.hello?.kind === "record") {
    if (action === "step") seek(Math.min(state.index + 1, state.hello.times.length - 1));
    if (action === "reset") seek(0);
    played = null;
    return;
  }
  connection.ask({ type: "control", action, value }).catch(() => {});
}

at("play").onclick = play;
at("step").onclick = () => control("step", 1);
at("reset").onclick = () => control("reset");
at("speed").onchange = (event) => control("speed", Number(event.target.value));
at("slider").oninput = (event) => {
  state.isPlaying = false;
  showPlaying();
  seek(Number(event.target.value));
};
document.addEventListener("keydown", (event) => {
  if (event.key === " " && event.target === document.body) {
    event.preventDefault();
    play();
  }
});

// -- questions

function timeAsked() {
  return state.hello?.kind === "record" ? { at: state.hello.times[state.index] } : {};
}

async function complete(text, cursor) {
  try {
    const answer = await connection.ask({ type: "complete", text, cursor, language: state.language });
    return answer.completions ?? [];
  } catch {
    return [];
  }
}

async function run() {
  const text = editor.text.trim() ? editor.text : "";
  if (!text) return;
  editor.remember(text);
  state.question = { text, language: state.language };
  state.sorted = null;
  await ask(true);
}

let isAsking = false;
let lastAsked = 0;
async function ask(isNew) {
  const question = state.question;
  isAsking = true;
  lastAsked = performance.now();
  try {
    const answer = await connection.ask({ type: "ask", ...question, ...timeAsked() });
    if (question !== state.question) return;
    if (answer.error) {
      state.answer = null;
      if (!isNew) state.question = null;
      scene.mark([], []);
      showError(answer.error);
    } else {
      state.answer = answer;
      scene.mark(answer.all, answer.lines, answer.boxes);
      showAnswer();
    }
    window.__ss.error = answer.error ?? null;
    window.__ss.answers += 1;
  } catch (error) {
    showError({ message: error.message, suggestions: [] });
  } finally {
    isAsking = false;
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
  const head = table.createTHead().insertRow();
  answer.columns.forEach((name, column) => {
    const isSorted = state.sorted?.column === column;
    const cell = element("th", name + (isSorted ? (state.sorted.isUp ? " ▴" : " ▾") : ""));
    cell.onclick = () => {
      state.sorted = { column, isUp: !(isSorted && state.sorted.isUp) };
      showAnswer();
    };
    head.append(cell);
  });
  const order = answer.rows.map((_, index) => index);
  if (state.sorted) {
    const { column, isUp } = state.sorted;
    order.sort((a, b) => (isUp ? 1 : -1) * compare(answer.rows[a][column], answer.rows[b][column]));
  }
  const body = table.createTBody();
  for (const index of order) {
    const row = body.insertRow();
    for (const value of answer.rows[index]) {
      const cell = row.insertCell();
      cell.textContent = cell.title = textOf(value);
      if (typeof value === "number") cell.className = "number";
    }
    const marks = answer.marks[index];
    if (!marks.length) continue;
    row.className = "marked";
    row.onclick = () => {
      for (const other of body.rows) other.classList.remove("chosen");
      row.classList.add("chosen");
      scene.mark(marks, []);
      pick(marks[0][0]);
    };
  }
  return table;
}

function compare(a, b) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a === "number" && typeof b === "number") return a - b;
  return textOf(a).localeCompare(textOf(b), undefined, { numeric: true });
}

function textOf(value) {
  if (value === null) return "";
  if (typeof value === "number" && !Number.isInteger(value)) return String(Number(value.toPrecision(6)));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

function element(name, text) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  return made;
}

at("run").onclick = run;
at("clear").onclick = () => {
  state.question = state.answer = null;
  scene.mark([], []);
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
  const box = at("entity");
  window.__ss.picked = null;
  if (entity === null) {
    box.hidden = true;
    return;
  }
  let answer;
  try {
    answer = await connection.ask({ type: "pick", entity, ...timeAsked() });
  } catch {
    return;
  }
  if (answer.error) return showError(answer.error);
  const title = element("h2", answer.name);
  const close = element("button", "×");
  close.onclick = () => pick(null);
  title.append(close);
  const list = element("dl");
  for (const [name, value] of Object.entries(answer.facts)) {
    const text = Array.isArray(value) ? value.join(", ") : String(value);
    list.append(element("dt", name), element("dd", text));
  }
  for (const [name, others] of Object.entries(answer.relations)) {
    const cell = element("dd", others.length ? undefined : "–");
    for (const other of others) {
      const button = element("button", other);
      button.onclick = () => pick(scene.head.entities.find((each) => each.name === other)?.id ?? null);
      cell.append(button);
    }
    list.append(element("dt", name), cell);
  }
  box.replaceChildren(title, list);
  box.hidden = false;
  window.__ss.picked = answer.name;
}

// What tests wait on and look at.
Object.assign(window.__ss, {
  poseOf: (name) => scene.poseOf(name),
  placeOf: (name) => scene.placeOf(name),
  type: (text) => (editor.text = text),
  run,
  seek,
  get frames() {
    return scene.framesDrawn;
  },
});
