// One of several: native radio buttons under labels, so that arrow keys, focus and screen readers do as everywhere.

/** Fills `box` with one for each of `entries`, [value, content...]; the one that is `chosen` is checked. */
export function choices(box, entries, chosen, choose) {
  // Where the focus was when the box is filled again.
  const focused = box.contains(document.activeElement);
  const labels = entries.map(([value, ...content]) => {
    const [label, input] = [document.createElement("label"), document.createElement("input")];
    input.type = "radio";
    input.name = box.id;
    input.value = value;
    input.checked = value === chosen;
    input.addEventListener("change", () => choose(value));
    label.append(input, ...content);
    return label;
  });
  box.replaceChildren(...labels);
  if (focused) box.querySelector(":checked").focus();
}
