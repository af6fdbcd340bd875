// Asked before a rotor is moved, or may be again: what, where, how far. Enter is on "Cancel", Escape cancels.

import { h } from "./dom.js";

// A limit of the datasheet as it is written there, in a unit; nothing where it is no plain number.
function limit(datasheet, name, scale, unit) {
  const found = new RegExp("^\\s*" + name + "\\s*=\\s*([-+\\d._eE]+)\\s*(#.*)?$", "m").exec(datasheet);
  const value = found ? Number(found[1].replaceAll("_", "")) : NaN;
  return value > 0 ? ", " + Number((scale * value).toPrecision(4)) + " " + unit + "," : "";
}

// What a job that moves the rotor does to it, in sentences.
export function motion(kind, rig) {
  const most = "Amplitudes follow from what is measured; they stay below half of the displacement limit" +
    limit(rig.datasheet, "displacement_m", 1e6, "µm") + " and half of the current limit" + limit(rig.datasheet, "current_a", 1, "A") + ".";
  return [
    kind === "health"
      ? "A health check excites every axis with a few tones, for a minute or two."
      : "A commissioning excites every axis, one after the other, with tones over the whole band.",
    most.replace(",.", "."),
    "The rotor must be levitated, and whoever is near it must know. “Stop the excitation” on the rig's page ends it at once.",
  ];
}

// Resolves to the options that were chosen, or to null when it was cancelled.
export function confirmed(title, words, place, profiles, go = "Move the rotor") {
  const choice = profiles && h("select", { id: "profile" }, Object.entries(profiles).map(([value, text]) => h("option", { value }, text)));
  return new Promise((answer) => {
    let chosen = null;
    const close = (options) => () => { chosen = options(); dialog.close(); };
    const dialog = h("dialog", { "aria-labelledby": "confirm-title" },
      h("h2", { id: "confirm-title" }, title),
      place ? h("p", { class: "about" }, "Controller ", h("code", {}, place)) : "",
      words.map((text) => h("p", {}, text)),
      choice ? h("p", { class: "row" }, h("label", { for: "profile" }, "Profile"), choice) : "",
      h("p", { class: "row" },
        h("button", { class: "cancel", autofocus: true, onclick: close(() => null) }, "Cancel"),
        h("button", { class: "go danger", onclick: close(() => (choice ? { profile: choice.value } : {})) }, go)));
    dialog.addEventListener("close", () => { dialog.remove(); answer(chosen); });
    document.body.append(dialog);
    dialog.showModal();
  });
}
