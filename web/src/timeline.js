// The time line: recorded ticks, bars of what holds when, and the place at which one looks.

const RUN = "#ff7a2b";
const SPAN = "#5aa9e6";
const FIRED = "#e6d37a";
const FAILED = "#8a3b46";
// Half of the width of the slider's handle: at the first tick its middle is so far from the edge.
const INSET = 8;
const LANE = 14;

export class Timeline {
  // on: { seek(index), live() }; elements: { slider, lanes, time, previous, next, live }
  constructor(elements, on) {
    this.elements = elements;
    this.on = on;
    this.times = [];
    this.numbers = [];
    this.index = 0;
    this.isLive = false;
    this.isFollowing = false;
    this.runs = [];
    this.spans = [];
    this.firings = [];
    elements.slider.oninput = () => this.go(Number(elements.slider.value));
    elements.previous.onclick = () => this.jump(-1);
    elements.next.onclick = () => this.jump(1);
    elements.live.onclick = () => this.follow();
    elements.lanes.onclick = (event) => this.goToPlace(event);
    new ResizeObserver(() => this.draw()).observe(elements.slider);
  }

  get time() {
    return this.times[this.index];
  }

  // Returns whether ticks before the known ones were dropped, or all are new.
  setTicks({ anew, keep, numbers, times, firings }) {
    const dropped = anew ? this.times.length : this.times.length - keep;
    const hadNone = !this.times.length;
    this.times = (anew ? [] : this.times.slice(dropped)).concat(times);
    this.numbers = (anew ? [] : this.numbers.slice(dropped)).concat(numbers);
    this.firings = firings;
    this.index = Math.max(0, Math.min(this.index - (anew ? 0 : dropped), this.times.length - 1));
    if (this.isFollowing || (hadNone && this.isLive)) this.index = Math.max(0, this.times.length - 1);
    this.elements.slider.max = Math.max(0, this.times.length - 1);
    this.show();
    this.draw();
    return dropped;
  }

  go(index) {
    if (!this.times.length) return;
    this.isFollowing = false;
    this.index = Math.max(0, Math.min(index, this.times.length - 1));
    this.show();
    this.on.seek(this.index);
  }

  follow() {
    this.isFollowing = true;
    this.index = Math.max(0, this.times.length - 1);
    this.show();
    this.on.live();
  }

  // The place of the last tick until a time.
  indexAt(time) {
    let low = 0;
    let high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time + 1e-9) low = middle + 1;
      else high = middle;
    }
    return Math.max(0, low - 1);
  }

  // The times at which something begins or ends.
  get changes() {
    const times = [
      ...this.runs.slice(1).map(([start]) => start),
      ...this.spans.flatMap(([, spans]) => spans.flat()),
      ...this.firings.map(([, time]) => time),
    ];
    return [...new Set(times)].sort((a, b) => a - b);
  }

  jump(step) {
    const now = this.time ?? 0;
    const changes = this.changes;
    const next = step > 0 ? changes.find((time) => time > now + 1e-9) : changes.findLast((time) => time < now - 1e-9);
    if (next !== undefined) this.go(this.indexAt(next));
  }

  setRuns(runs) {
    this.runs = runs;
    this.show();
    this.draw();
  }

  setSpans(spans) {
    this.spans = spans;
    this.show();
    this.draw();
  }

  show() {
    const { slider, previous, next, live } = this.elements;
    slider.value = this.index;
    slider.disabled = this.times.length < 2;
    live.hidden = !this.isLive;
    live.disabled = this.isFollowing;
    const changes = this.changes;
    const now = this.time ?? 0;
    previous.hidden = next.hidden = !changes.length;
    previous.disabled = !(changes[0] < now - 1e-9);
    next.disabled = !(changes[changes.length - 1] > now + 1e-9);
  }

  placeOf(time, width) {
    const last = Math.max(1, this.times.length - 1);
    return INSET + ((width - 2 * INSET) * this.indexAt(time)) / last;
  }

  goToPlace(event) {
    const canvas = event.target.closest("canvas");
    if (!canvas) return;
    const box = canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - INSET) / (box.width - 2 * INSET);
    this.go(Math.round(share * (this.times.length - 1)));
  }

  get lanes() {
    const lanes = [];
    if (this.runs.length) {
      const counts = this.runs.map(([, , count]) => count).filter((count) => count > 0);
      const [least, most] = [Math.min(...counts), Math.max(...counts)];
      const alphaOf = (count) => (count > 0 ? (most > least ? 0.3 + (0.7 * (count - least)) / (most - least) : 1) : 0);
      const bars = this.runs.map(([start, end, count]) => ({
        start, end, colour: count < 0 ? FAILED : RUN, alpha: count < 0 ? 1 : alphaOf(count),
      }));
      lanes.push({ label: "answer", bars, ticks: this.runs.slice(1).map(([start]) => start) });
    }
    for (const [label, spans] of this.spans) {
      lanes.push({ label, bars: spans.map(([start, end]) => ({ start, end, colour: SPAN, alpha: 0.9 })), ticks: [] });
    }
    for (const name of new Set(this.firings.map(([each]) => each))) {
      const times = this.firings.filter(([each]) => each === name).map(([, time]) => time);
      lanes.push({ label: name, bars: times.map((time) => ({ start: time, end: time, colour: FIRED, alpha: 1 })), ticks: [] });
    }
    return lanes;
  }

  draw() {
    const box = this.elements.lanes;
    const lanes = this.times.length > 1 ? this.lanes : [];
    box.hidden = !lanes.length;
    while (box.children.length > lanes.length) box.lastChild.remove();
    lanes.forEach((lane, number) => {
      const row = box.children[number] ?? box.appendChild(laneRow());
      const [label, canvas] = row.children;
      label.textContent = label.title = lane.label;
      this.drawLane(canvas, lane);
    });
  }

  drawLane(canvas, { bars, ticks }) {
    const width = canvas.clientWidth || 300;
    const ratio = window.devicePixelRatio;
    canvas.width = width * ratio;
    canvas.height = LANE * ratio;
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.fillStyle = "#262d38";
    context.fillRect(INSET, 2, width - 2 * INSET, LANE - 4);
    for (const { start, end, colour, alpha } of bars) {
      const from = this.placeOf(start, width);
      context.globalAlpha = alpha;
      context.fillStyle = colour;
      context.fillRect(from, 2, Math.max(2, this.placeOf(end, width) - from), LANE - 4);
    }
    context.globalAlpha = 1;
    context.fillStyle = "#f4f6f8";
    for (const time of ticks.length < width / 3 ? ticks : []) {
      context.fillRect(this.placeOf(time, width) - 0.5, 1, 1, LANE - 2);
    }
  }
}

function laneRow() {
  const row = document.createElement("div");
  row.className = "lane";
  row.append(document.createElement("span"), document.createElement("canvas"));
  return row;
}
