// Makes elements.

export function element(name, text) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  return made;
}

// Lets a click, Enter or the space bar do something; the tab key goes there.
export function pressable(element, action) {
  element.tabIndex = 0;
  element.onclick = action;
  element.onkeydown = (event) => {
    if (event.target !== element || (event.key !== "Enter" && event.key !== " ")) return;
    event.preventDefault();
    action();
  };
}
