// A plot of values over time, with axes and the time at which one looks.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 400;
const HEIGHT = 130;
const LEFT = 52;
const BOTTOM = 18;
const TOP = 8;
const RIGHT = 8;

// points: [[time, value or null], …]; returns { element, setTime }
export function plot(points, onTime) {
  const svg = part("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot" });
  const known = points.filter((each) => each[1] !== null);
  if (!known.length) {
    const text = part("text", { x: WIDTH / 2, y: HEIGHT / 2, "text-anchor": "middle" });
    text.textContent = "nothing is recorded";
    svg.append(text);
    return { element: svg, setTime() {} };
  }
  const [start, end] = [points[0][0], points[points.length - 1][0]];
  let [low, high] = [Math.min(...known.map((each) => each[1])), Math.max(...known.map((each) => each[1]))];
  // A value that hardly moves is a flat line, not its noise.
  const least = Math.max(1e-4, 1e-4 * Math.max(Math.abs(low), Math.abs(high)));
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  const x = (time) => LEFT + ((WIDTH - LEFT - RIGHT) * (time - start)) / (end - start || 1);
  const y = (value) => HEIGHT - BOTTOM - ((HEIGHT - TOP - BOTTOM) * (value - low)) / (high - low);
  for (const value of [low, (low + high) / 2, high]) {
    svg.append(part("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(value), y2: y(value), class: "grid" }));
    label(svg, LEFT - 5, y(value) + 4, "end", short(value, high - low));
  }
  for (const time of [start, (start + end) / 2, end]) {
    const anchor = time === start ? "start" : time === end ? "end" : "middle";
    label(svg, x(time), HEIGHT - 4, anchor, `${short(time, end - start)} s`);
  }
  let path = "";
  let isDown = false;
  for (const [time, value] of points) {
    if (value !== null) path += `${isDown ? "L" : "M"}${x(time).toFixed(1)} ${y(value).toFixed(1)}`;
    isDown = value !== null;
  }
  svg.append(part("path", { d: path, class: "curve" }));
  const cursor = part("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "cursor" });
  svg.append(cursor);
  svg.onclick = (event) => {
    const box = svg.getBoundingClientRect();
    const place = ((event.clientX - box.left) / box.width) * WIDTH;
    onTime(start + ((place - LEFT) / (WIDTH - LEFT - RIGHT)) * (end - start));
  };
  const setTime = (time) => {
    const place = x(Math.min(Math.max(time, start), end));
    cursor.setAttribute("x1", place);
    cursor.setAttribute("x2", place);
  };
  return { element: svg, setTime };
}

function part(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function label(svg, x, y, anchor, text) {
  const made = part("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  svg.append(made);
}

function short(value, range) {
  const digits = Math.max(0, Math.min(5, 2 - Math.floor(Math.log10(range || 1))));
  return String(Number(value.toFixed(digits)));
}
