// The box for queries: colours, completion from the server, history, and marks under errors.

import { autocompletion, closeCompletion, completionKeymap, selectedCompletion } from "@codemirror/autocomplete";
import { defaultKeymap, history, historyKeymap } from "@codemirror/commands";
import { sql } from "@codemirror/lang-sql";
import { HighlightStyle, StreamLanguage, bracketMatching, syntaxHighlighting } from "@codemirror/language";
import { setDiagnostics } from "@codemirror/lint";
import { Compartment, EditorState, Prec } from "@codemirror/state";
import { EditorView, drawSelection, keymap, placeholder } from "@codemirror/view";
import { tags } from "@lezer/highlight";

const WORDS =
  /^(?:SELECT|FROM|WHERE|GROUP|BY|HAVING|ORDER|ASC|DESC|LIMIT|OFFSET|AS|START|WITH|CONNECT|STOP|AND|OR|XOR|NOT|IN|LIKE|BETWEEN|IS|NULL|CASE|WHEN|THEN|ELSE|END|IF|True|False|None|this)\b/i;
const KEPT = 100;
const STORE = "ssduck history";

const selectscript = StreamLanguage.define({
  token(stream) {
    if (stream.eatSpace()) return null;
    if (stream.match(/^(?:\/\/|#|--\s)[^\n]*/) || stream.match(/^\/\*[\s\S]*?\*\//)) return "comment";
    if (stream.match(/^'(?:[^'\\]|\\.|'')*'?/) || stream.match(/^"(?:[^"\\]|\\.|"")*"?/)) return "string";
    if (stream.match(/^\d+(?:\.\d*)?(?:[eE][+-]?\d+)?/)) return "number";
    if (stream.match(WORDS)) return "keyword";
    if (stream.match(/^[A-Za-z_]\w*(?=\s*\()/)) return "function";
    if (stream.match(/^[A-Za-z_]\w*/)) return "variableName";
    stream.next();
    return null;
  },
  tokenTable: { function: tags.function(tags.variableName) },
});

const colours = HighlightStyle.define([
  { tag: tags.keyword, color: "#8fb7ff", fontWeight: "600" },
  { tag: [tags.string, tags.special(tags.string)], color: "#a5d99c" },
  { tag: tags.number, color: "#f0b87a" },
  { tag: tags.comment, color: "#7d8797", fontStyle: "italic" },
  { tag: tags.function(tags.variableName), color: "#e6d37a" },
]);

const KINDS = {
  alias: "variable", column: "property", entity: "constant", form: "type", function: "function",
  keyword: "keyword", link: "constant", table: "class", variable: "variable", world: "namespace",
};

export class Editor {
  // complete(text, cursor) → promise of [[text, start, kind, usage, about], …]
  constructor(parent, nonce, { run, complete }) {
    this.language = new Compartment();
    this.entries = read();
    this.place = this.entries.length;
    const keys = [
      { key: "Enter", run: () => (run(), true), shift: () => false },
      { key: "Mod-Enter", run: () => (run(), true) },
      { key: "Alt-ArrowUp", run: () => this.recall(-1) },
      { key: "Alt-ArrowDown", run: () => this.recall(1) },
      { key: "ArrowUp", run: (view) => this.isOnLine(view, 1) && this.recall(-1) },
      { key: "ArrowDown", run: (view) => this.isOnLine(view, view.state.doc.lines) && this.recall(1) },
    ];
    this.view = new EditorView({
      parent,
      state: EditorState.create({
        doc: "",
        extensions: [
          EditorView.cspNonce.of(nonce),
          history(),
          drawSelection(),
          bracketMatching(),
          EditorView.lineWrapping,
          placeholder("SELECT id(this) FROM …"),
          // Before the keys of the completions, which are of the highest precedence, too.
          Prec.highest(keymap.of([{ key: "Enter", run: (view) => isThere(view) && (closeCompletion(view), run(), true) }])),
          autocompletion({ override: [(context) => options(context, complete)], icons: false }),
          this.language.of(selectscript),
          syntaxHighlighting(colours),
          keymap.of(completionKeymap),
          Prec.low(keymap.of([{ key: "Shift-Enter", run: newLine }, ...keys])),
          keymap.of([...historyKeymap]),
          Prec.lowest(keymap.of(defaultKeymap)),
          EditorView.theme({}, { dark: true }),
        ],
      }),
    });
  }

  get text() {
    return this.view.state.doc.toString();
  }

  set text(text) {
    this.view.dispatch({
      changes: { from: 0, to: this.view.state.doc.length, insert: text },
      selection: { anchor: text.length },
    });
  }

  setLanguage(name) {
    this.view.dispatch({ effects: this.language.reconfigure(name === "sql" ? sql() : selectscript) });
  }

  replace(start, end, text) {
    this.view.dispatch({ changes: { from: start, to: end, insert: text } });
  }

  showError(error) {
    const length = this.view.state.doc.length;
    const marks = [];
    if (error && error.start !== null && error.start !== undefined) {
      const from = Math.min(error.start, length);
      const to = Math.min(Math.max(error.end, from), length);
      marks.push({ from, to, severity: "error", message: error.message });
    }
    this.view.dispatch(setDiagnostics(this.view.state, marks));
  }

  remember(text) {
    this.entries = [...this.entries.filter((each) => each !== text), text].slice(-KEPT);
    this.place = this.entries.length;
    try {
      localStorage.setItem(STORE, JSON.stringify(this.entries));
    } catch {
      // The browser keeps nothing here: the history lasts as long as the page.
    }
  }

  recall(step) {
    const place = this.place + step;
    if (place < 0 || place > this.entries.length) return true;
    this.place = place;
    this.text = this.entries[place] ?? "";
    return true;
  }

  isOnLine(view, number) {
    const { main } = view.state.selection;
    return main.empty && view.state.doc.lineAt(main.head).number === number;
  }
}

// Whether what is chosen of the completions stands there already: Enter would change nothing.
function isThere(view) {
  const label = selectedCompletion(view.state)?.label;
  const { head } = view.state.selection.main;
  const start = head - (label?.length ?? 0);
  const [before, word] = [view.state.sliceDoc(Math.max(0, start - 1), Math.max(0, start)), view.state.sliceDoc(Math.max(0, start), head)];
  return start >= 0 && word === label && !/\w/.test(before);
}

function newLine(view) {
  view.dispatch(view.state.replaceSelection("\n"), { scrollIntoView: true });
  return true;
}

function read() {
  try {
    const entries = JSON.parse(localStorage.getItem(STORE) ?? "[]");
    return Array.isArray(entries) ? entries.filter((each) => typeof each === "string") : [];
  } catch {
    return [];
  }
}

async function options(context, complete) {
  const word = context.matchBefore(/[\w.'"]+/);
  if (!context.explicit && !word && !/\b(?:FROM|AS)\s$/i.test(context.state.sliceDoc(0, context.pos))) {
    return null;
  }
  const found = await complete(context.state.doc.toString(), context.pos);
  if (!found.length) return null;
  return {
    from: found[0][1],
    filter: false,
    options: found.map(([label, , kind, usage, about]) => ({
      label,
      detail: kind,
      type: KINDS[kind],
      info: [usage, about].filter(Boolean).join("\n") || undefined,
    })),
  };
}
