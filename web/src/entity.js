// What is told of an entity: its row, relations, links and joints, and plots of its past.

import { element, pressable } from "./elements.js";
import { plot } from "./plot.js";

export class EntityPanel {
  // on: { pick(name or null), mark(links), plot(question) → promise, go(time) }
  constructor(box, on) {
    this.box = box;
    this.on = on;
    this.plotted = null;
    this.choice = { column: "z", joint: null };
  }

  hide() {
    this.box.hidden = true;
    this.entity = this.plotted = null;
  }

  show(entity, answer, time) {
    const isSame = this.entity === entity;
    this.entity = entity;
    const title = element("h2", answer.name);
    const close = element("button", "×");
    close.title = "Close";
    close.onclick = () => this.on.pick(null);
    title.append(close);
    const list = element("dl");
    for (const [name, value] of Object.entries(answer.facts)) {
      list.append(element("dt", name), element("dd", Array.isArray(value) ? value.join(", ") : String(value)));
    }
    for (const [name, others] of Object.entries(answer.relations)) {
      const cell = element("dd", others.length ? undefined : "–");
      for (const [other, gap] of others) {
        const button = element("button", gap === null ? other : `${other} ${(gap * 100).toFixed(1)} cm`);
        button.onclick = () => this.on.pick(other);
        cell.append(button);
      }
      list.append(element("dt", name), cell);
    }
    const opened = new Set([...this.box.querySelectorAll("details[open]")].map((each) => each.dataset.name));
    const parts = [title, list];
    if (answer.links.length > 1) {
      parts.push(this.part("links", `${answer.links.length} links`, ["link", "x (m)", "y", "z"], answer.links, opened, (number) =>
        this.on.mark([[entity, number]])));
    }
    if (answer.joints.length) {
      const heads = ["joint", "type", "position", "velocity", "lower", "upper"];
      parts.push(this.part("joints", `${answer.joints.length} joints`, heads, answer.joints, opened, (number) =>
        this.plot({ column: "", joint: answer.joints[number][0] }, time)));
    }
    if (answer.columns) parts.push(this.plotBox(answer.columns, isSame, time));
    this.box.replaceChildren(...parts);
    this.box.hidden = false;
  }

  part(name, summary, heads, rows, opened, onRow) {
    const details = element("details");
    details.dataset.name = name;
    details.open = opened.has(name);
    const table = element("table");
    const head = table.createTHead().insertRow();
    for (const text of heads) head.append(element("th", text));
    const body = table.createTBody();
    rows.forEach((values, number) => {
      const row = body.insertRow();
      row.className = "marked";
      pressable(row, () => onRow(number));
      for (const value of values) {
        const cell = row.insertCell();
        cell.textContent = typeof value === "number" ? String(Number(value.toFixed(4))) : (value ?? "");
        cell.title = cell.textContent;
        if (typeof value === "number") cell.className = "number";
      }
    });
    details.append(element("summary", summary), table);
    return details;
  }

  plotBox(columns, isSame, time) {
    const box = element("div");
    box.className = "plots";
    const select = element("select");
    select.title = "The column whose past is plotted";
    for (const name of columns) select.append(new Option(name, name, false, name === this.choice.column));
    select.onchange = () => this.plot({ column: select.value, joint: null }, time);
    this.label = element("span", "over time");
    const head = element("div");
    head.append(select, this.label);
    this.holder = element("div");
    box.append(head, this.holder);
    if (isSame && this.plotted) this.holder.append(this.plotted.element);
    else this.plot(isSame ? this.choice : { column: this.choice.column || "z", joint: null }, time);
    return box;
  }

  async plot(choice, time) {
    this.choice = choice;
    const { entity } = this;
    let answer;
    try {
      answer = await this.on.plot({ entity, ...choice });
    } catch {
      return;
    }
    if (entity !== this.entity) return;
    this.label.textContent = choice.joint ? `position of ${choice.joint}, over time` : "over time";
    this.plotted = plot(answer.error ? [] : answer.points, (at) => this.on.go(at));
    this.plotted.setTime(this.time ?? time);
    this.holder.replaceChildren(this.plotted.element);
  }

  setTime(time) {
    this.time = time;
    this.plotted?.setTime(time);
  }
}
