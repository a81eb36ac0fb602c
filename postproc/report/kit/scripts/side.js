"use strict";
// What stays in sight next to the sections: on a narrow screen it lies over them, and folds away.
for (const aside of document.querySelectorAll("aside")) {
  const button = Object.assign(document.createElement("button"), { type: "button" });
  const fold = (folded) => {
    aside.classList.toggle("folded", folded);
    button.textContent = folded ? "show ▴" : "hide ▾";
    button.setAttribute("aria-expanded", String(!folded));
  };
  button.addEventListener("click", () => fold(!aside.classList.contains("folded")));
  aside.querySelector("h2").append(button);
  fold(matchMedia("(max-width: 760px)").matches);
}

// On paper all folds of what is printed are open; afterwards they are as they were.
const unfolded = [];
addEventListener("beforeprint", () => {
  unfolded.push(...document.querySelectorAll("section:not(.only-screen) details:not([open])"));
  for (const fold of unfolded) fold.open = true;
});
addEventListener("afterprint", () => {
  for (const fold of unfolded.splice(0)) fold.open = false;
});
