// The page: its views by #hash, the connection to the console, STOP.

import { types, write } from "./lib/dom.js";
import { ask, notify } from "./lib/messages.js";
import { Socket } from "./lib/socket.js";
import { mood, stateWords } from "./lib/words.js";
import { VIEWS } from "./views.js";

const byId = (id) => document.getElementById(id);

const socket = new Socket(new URL("socket", location.href).href.replace(/^http/, "ws"));
const views = {}; // name -> {show(), hide(), navigate(rest of the hash)}; each view is created when it is first shown
let shown = null;

// -- views

function route() {
  const [name, ...rest] = location.hash.slice(1).split("/");
  const wanted = Object.hasOwn(VIEWS, name) ? name : Object.keys(VIEWS)[0];
  if (shown !== wanted) {
    if (shown !== null) {
      views[shown].hide();
      byId(shown).hidden = true;
    }
    shown = wanted;
    views[wanted] ??= VIEWS[wanted](byId(wanted), socket);
    byId(wanted).hidden = false;
    views[wanted].show();
    byId("main").scrollTop = 0;
  }
  views[wanted].navigate?.(decoded(rest.join("/")));
  for (const tab of byId("tabs").children) {
    if (tab.hash === `#${wanted}`) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  showLine(); // disable a new view's driving controls while driving is not allowed
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return ""; // an unknown hash
  }
}

// -- the connection

let lastState = "";

function showLine() {
  const { open, hello } = socket;
  const state = open && hello ? "open" : lastState === "" ? "begin" : "lost";
  document.body.dataset.line = state;
  document.body.dataset.role = hello?.role ?? "watch";
  write(byId("daemon"), hello?.daemon ?? "Midspan");
  document.title = `${state === "lost" ? "(lost) " : ""}${hello?.daemon ?? ""} – Midspan`.replace(/^ – /, "");
  const role = hello?.role === "watch" ? "Watching" : "Connected";
  write(byId("line-text"), state === "open" ? role : state === "begin" ? "Connecting" : "No connection");
  write(byId("lost"), state === "lost" ? "Connection lost. The values shown are outdated. Reconnecting …" : "");
  const watches = state === "open" && hello.role === "watch";
  write(byId("watching"), watches ? `Watching${hello.who ? ` as ${hello.who}` : ""}: commands are disabled, including STOP.` : "");
  byId("stop").disabled = watches;
  if (state === "lost") knock();
  for (const part of document.querySelectorAll(".drives")) part.inert = !socket.mayDrive;
  if (state === "open" && lastState === "lost") notify("Reconnected.");
  if (state !== "begin") lastState = state;
}

let knocked = 0;

/** Check whether the console is up but the login has expired. */
async function knock() {
  const now = Date.now();
  if (location.protocol !== "https:" || now - knocked < 3000) return;
  knocked = now;
  const answer = await fetch("whoami", { cache: "no-store" }).catch(() => null);
  if (answer?.status === 401) location.replace("login");
}

function showDriving(driving, why) {
  const place = byId("driving");
  place.dataset.mood = driving ? mood(driving) : "calm";
  write(place, driving ? stateWords(driving) : why || "");
}

// -- STOP

let stopped = 0; // when STOP was last pressed

function stop() {
  const now = performance.now();
  if (byId("stop").disabled) return;
  if (now - stopped < 300) return; // the click that follows a touch
  stopped = now;
  dispatchEvent(new Event("midspan-stop")); // on which manual driving ends
  socket.release();
  ask(socket, "STOP", "halt", {}); // the console reports whether every base stands still
}

byId("stop").addEventListener("pointerdown", (event) => event.button === 0 && stop());
byId("stop").addEventListener("click", stop);
addEventListener(
  "keydown",
  (event) => {
    if (event.key !== " " || types(event.target)) return;
    event.preventDefault(); // so that the key does not press the focused button
    event.stopPropagation();
    if (!event.repeat) stop();
  },
  true,
);
addEventListener("keyup", (event) => event.key === " " && !types(event.target) && event.preventDefault(), true);

socket.addEventListener("state", showLine);
socket.addEventListener("refused", (event) => notify(event.detail, { bad: true }));
socket.watch("driving", showDriving);
addEventListener("hashchange", route);
setTimeout(() => lastState === "" && ((lastState = "lost"), showLine()), 3000);
showLine();
route();
