"use strict";
// One page, three screens: intro, trial (one video and its questions), done. State lives in `state` and in
// localStorage, is written at every rating, and holds nothing but the rater's code, the place and the ratings.
(() => {
  const $ = (id) => document.getElementById(id);
  const study = JSON.parse($("study").textContent);
  const SLOT = `video-study:${study.study}`;
  const CODE = new RegExp(`^${study.code}$`);
  const keys = study.questions.map((question) => question.key);
  const videos = new Map(study.videos.map((video) => [video.id, video]));
  const video = $("video");
  let state = null; // {rater, at, answers: {video id: {Q1: 3, ...}}}
  let order = []; // ids, as this rater sees them
  let broken = false; // the video on show cannot be played

  // The same code gives the same order, on any machine: xmur3 seeds mulberry32, which drives a Fisher-Yates shuffle.
  function shuffled(ids, text) {
    let hash = 1779033703 ^ text.length;
    for (let i = 0; i < text.length; i++) {
      hash = Math.imul(hash ^ text.charCodeAt(i), 3432918353);
      hash = (hash << 13) | (hash >>> 19);
    }
    hash = Math.imul(hash ^ (hash >>> 16), 2246822507);
    hash = Math.imul(hash ^ (hash >>> 13), 3266489909);
    let seed = (hash ^ (hash >>> 16)) >>> 0;
    const uniform = () => {
      seed = (seed + 0x6d2b79f5) | 0;
      let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
      t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
      return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
    };
    const list = [...ids];
    for (let i = list.length - 1; i > 0; i--) {
      const j = Math.floor(uniform() * (i + 1));
      [list[i], list[j]] = [list[j], list[i]];
    }
    return list;
  }

  function warn(text) {
    $("warning").textContent = text;
    $("warning").hidden = false;
  }

  function keep() {
    try {
      localStorage.setItem(SLOT, JSON.stringify(state));
    } catch {
      warn("This browser does not remember your answers: save them before you close the page.");
    }
  }

  // What an earlier visit left; whatever does not fit the study is dropped.
  function recall() {
    let found = null;
    try {
      found = JSON.parse(localStorage.getItem(SLOT));
    } catch {
      return null;
    }
    if (typeof found?.rater !== "string" || !CODE.test(found.rater)) return null;
    const answers = {};
    for (const id of videos.keys()) {
      const given = (found.answers ?? {})[id] ?? {};
      const kept = keys.filter((key) => study.scale.includes(given[key]));
      if (kept.length) answers[id] = Object.fromEntries(kept.map((key) => [key, given[key]]));
    }
    const at = Number.isInteger(found.at) ? Math.min(Math.max(found.at, 0), videos.size) : 0;
    return { rater: found.rater, at, answers };
  }

  const answersOf = (id) => state.answers[id] ?? {};
  const complete = (id) => keys.every((key) => key in answersOf(id));

  function show(screen) {
    for (const name of ["intro", "trial", "done"]) $(name).hidden = name !== screen;
    if (screen !== "trial") {
      video.removeAttribute("src");
      video.load();
    }
    scrollTo(0, 0);
  }

  function begin(rater) {
    order = shuffled(videos.keys(), `${study.study}:${rater}`);
    $("progress").max = order.length;
    goTo(state.at);
  }

  function goTo(index) {
    state.at = index;
    keep();
    if (index >= order.length) return finish();
    const id = order[index];
    show("trial");
    broken = false;
    $("broken").hidden = true;
    video.src = videos.get(id).src;
    video.play().catch(() => {}); // where a browser starts nothing by itself, the controls do
    $("count").textContent = `Video ${index + 1} of ${order.length}`;
    for (const input of $("questions").querySelectorAll("input")) {
      input.checked = answersOf(id)[input.name] === Number(input.value);
    }
    refresh();
    $("count").focus({ preventScroll: true });
  }

  function refresh() {
    $("progress").value = order.filter(complete).length;
    $("back").disabled = state.at === 0;
    $("next").disabled = !broken && !complete(order[state.at]);
    $("next").textContent = broken ? "Skip" : state.at + 1 === order.length ? "Finish" : "Next";
  }

  function rate(key, value) {
    state.answers[order[state.at]] = { ...answersOf(order[state.at]), [key]: value };
    keep();
    refresh();
  }

  function finish() {
    const rated = order.filter(complete).length;
    show("done");
    $("thanks").textContent = rated === order.length ? "Thank you!" : "Thank you so far";
    $("rated").textContent = `You rated ${rated} of ${order.length} videos.`;
    $("saved").textContent = "";
    $("json").disabled = $("csv").disabled = rated === 0;
    $("thanks").focus({ preventScroll: true });
  }

  // Rows of the answers: videos with all ratings, in the order they were seen.
  function rows() {
    return order
      .map((id, index) => ({ position: index + 1, video: id, ...answersOf(id) }))
      .filter((row) => complete(row.video))
      .map((row) => ({ study: study.study, rater: state.rater, ...row }));
  }

  function asJson() {
    const answers = rows().map((row) => Object.fromEntries(study.columns.slice(2).map((name) => [name, row[name]])));
    return `${JSON.stringify({ format: study.format, study: study.study, rater: state.rater, answers }, null, 1)}\n`;
  }

  // No cell needs quotes: codes and ids are letters, digits, - and _.
  function asCsv() {
    return [study.columns, ...rows().map((row) => study.columns.map((name) => row[name]))]
      .map((cells) => `${cells.join(",")}\r\n`)
      .join("");
  }

  function save(text, type, ending) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = `answers-${state.rater}.${ending}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    $("saved").textContent = `Saved as ${link.download}, where this browser keeps downloads.`;
  }

  function element(name, text = "", parent = null) {
    const made = document.createElement(name);
    made.textContent = text;
    parent?.append(made);
    return made;
  }

  function build() {
    for (const total of document.querySelectorAll(".total")) total.textContent = videos.size;
    const [worst, best] = [study.scale[0], study.scale[study.scale.length - 1]];
    for (const question of study.questions) {
      const pair = element("div", "", $("asked"));
      element("dt", question.title, pair);
      element("dd", question.text, pair);

      const group = element("fieldset", "", $("groups"));
      group.dataset.key = question.key;
      group.tabIndex = -1;
      element("legend", question.title, group);
      element("p", question.text, group);
      const scale = element("div", "", group);
      scale.className = "scale";
      for (const value of study.scale) {
        const label = element("label", "", scale);
        const input = element("input", "", label);
        Object.assign(input, { type: "radio", name: question.key, value: String(value) });
        element("span", String(value), label);
        if (value === worst || value === best) element("small", value === worst ? "worst" : "best", label);
      }
    }
  }

  function onKey(event) {
    if ($("trial").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
    const value = Number(event.key);
    if (study.scale.includes(value) && !broken) {
      const groups = [...$("groups").children];
      const focused = document.activeElement.closest("fieldset");
      const group = focused ?? groups.find((each) => !(each.dataset.key in answersOf(order[state.at])));
      if (!group) return;
      group.querySelector(`input[value="${value}"]`).checked = true;
      rate(group.dataset.key, value);
      // The question gets the focus, not one of its ratings: none of them is to stand out.
      (groups[groups.indexOf(group) + 1] ?? $("next")).focus();
    } else if (event.key === "Enter") {
      if (document.activeElement.closest("button, video")) return; // they have their own
      if (!$("next").disabled) $("questions").requestSubmit();
    } else if (event.key === "b" || event.key === "B") {
      if (state.at > 0) goTo(state.at - 1);
    } else if (event.key === "r" || event.key === "R") {
      video.currentTime = 0;
      video.play().catch(() => {});
    } else if (event.key === "p" || event.key === "P") {
      if (video.paused) video.play().catch(() => {});
      else video.pause();
    } else {
      return;
    }
    event.preventDefault();
  }

  build();
  $("groups").addEventListener("change", (event) => rate(event.target.name, Number(event.target.value)));
  $("questions").addEventListener("submit", (event) => {
    event.preventDefault();
    if (!$("next").disabled) goTo(state.at + 1);
  });
  $("back").addEventListener("click", () => goTo(state.at - 1));
  $("leave").addEventListener("click", finish);
  $("return").addEventListener("click", () => {
    const open = order.findIndex((id) => !complete(id));
    goTo(open < 0 ? 0 : open);
  });
  $("json").addEventListener("click", () => save(asJson(), "application/json", "json"));
  $("csv").addEventListener("click", () => save(asCsv(), "text/csv", "csv"));
  $("another").addEventListener("click", () => {
    if (!confirm("Have you saved your answers? They are removed from this browser.")) return;
    localStorage.removeItem(SLOT);
    location.reload();
  });
  $("start").addEventListener("submit", (event) => {
    event.preventDefault();
    state = { rater: $("rater").value, at: 0, answers: {} };
    begin(state.rater);
  });
  video.addEventListener("error", () => {
    if (!video.getAttribute("src")) return;
    broken = true;
    $("broken").hidden = false;
    refresh();
  });
  document.addEventListener("keydown", onKey);
  addEventListener("storage", (event) => event.key === SLOT && location.reload()); // another tab went on: follow it

  state = recall();
  if (state) {
    begin(state.rater);
  } else {
    const bytes = Array.from(crypto.getRandomValues(new Uint8Array(4)));
    $("rater").value = bytes.map((byte) => byte.toString(16).padStart(2, "0")).join("");
    show("intro");
  }
})();
