"use strict";
{
  const $ = (id) => document.getElementById(id);
  const form = $("new");
  const limits = JSON.parse(form.dataset.limits);
  const chosen = { recording: [], plate: [], clip: [] };
  const sizes = new Map(); // of files that this browser can show
  const VIDEO = /\.(mp4|mov|mkv|avi|webm|m4v|mts|m2ts|mpg|mpeg|ts|wmv|mxf|gif)$/i;
  const PLATE = /^(.*_)?(plate|background)\.[a-z]+$/i;
  const STATES = {
    waiting: ["waits for its turn", "warn"], running: ["is being computed", "warn"], cancelling: ["is being ended", "warn"],
    done: ["done", "good"], refused: ["cannot be used", "bad"], failed: ["failed", "bad"], cancelled: ["cancelled", "warn"],
    stopped: ["stopped", "warn"],
  };
  const ABOUT = {
    "report.html": "the result on one page that opens anywhere",
    "motion.glb": "the moving body, for Blender and viewers of glTF",
    "motion.bvh": "the motion, for other rigs",
    "joints.trc": "joints, for OpenSim",
    "joints.c3d": "joints, for motion capture programs",
    "joints.csv": "joints, as a table",
    "amass.npz": "the motion in AMASS's layout",
    "slowmotion.mp4": "film in slow motion: blurred, body, re-blurred",
    "exact_time.mp4": "the same film, each picture at its true time",
    "overlay.mp4": "film of the body over the blurred pictures",
    "strip.png": "pictures side by side: input, matte, body, re-blurred, rest",
    "motion.npz": "the motion: poses and joints per instant",
    "alternatives.npz": "other motions that explain the picture, with probabilities",
    "curves.json": "how the fit went",
    "edges.json": "where neighbouring pictures meet",
    "texture.png": "the body's colours",
    "result.json": "figures, options, versions",
  };
  const made = (tag, text = "", more = {}) => Object.assign(document.createElement(tag), { textContent: text }, more);
  const isVideo = () => chosen.recording.some((file) => VIDEO.test(file.name));
  const bytes = (size) => (size < 1e6 ? `${Math.max(1, Math.round(size / 1e3))} kB` : `${(size / 1e6).toFixed(1)} MB`);

  async function ask(path, method = "GET") {
    const answer = await fetch(path, { method });
    const content = await answer.json().catch(() => ({ error: "the server's answer cannot be read" }));
    if (!answer.ok) throw new Error(content.error || `the server answers ${answer.status}`);
    return content;
  }

  // ---- files that are dropped or chosen

  function take(role, files) {
    const order = new Intl.Collator(undefined, { numeric: true });
    for (const file of [...files].sort((one, other) => order.compare(one.name, other.name))) {
      const place = role !== "recording" ? role : /\.toml$/i.test(file.name) ? "clip" : PLATE.test(file.name) ? "plate" : role;
      const several = place === "recording" && !VIDEO.test(file.name) && !isVideo();
      chosen[place] = several ? [...chosen[place], file] : [file];
      if (place === "clip") document.querySelector("details").open = true;
    }
    say("");
    draw();
  }

  function draw() {
    for (const area of document.querySelectorAll(".drop")) {
      const list = area.querySelector(".chosen");
      for (const shown of list.querySelectorAll("[src]")) URL.revokeObjectURL(shown.src);
      list.replaceChildren(...chosen[area.dataset.role].map((file) => item(area.dataset.role, file)));
    }
    for (const one of document.querySelectorAll("[data-only=video]")) one.hidden = !isVideo();
  }

  function item(role, file) {
    const line = made("li");
    if (role !== "clip") line.append(look(file));
    const drop = made("button", "leave out", { type: "button", ariaLabel: `leave out ${file.name}` });
    drop.addEventListener("click", () => {
      chosen[role] = chosen[role].filter((one) => one !== file);
      say("");
      draw();
      $(role).focus();
    });
    line.append(made("span", `${file.name}, ${bytes(file.size)}`), drop);
    return line;
  }

  function look(file) {
    const shown = made(VIDEO.test(file.name) && !/\.gif$/i.test(file.name) ? "span" : "img", "", { alt: "" });
    if (shown.tagName === "SPAN") return shown;
    const known = new Promise((done) => {
      shown.addEventListener("load", () => done([shown.naturalWidth, shown.naturalHeight]));
      shown.addEventListener("error", () => (shown.remove(), done(null))); // TIFF, or damaged: the command tells
    });
    if (!sizes.has(file)) sizes.set(file, known);
    shown.src = URL.createObjectURL(file);
    return shown;
  }

  for (const area of document.querySelectorAll(".drop")) {
    const { role } = area.dataset;
    $(role).addEventListener("change", (event) => {
      take(role, event.target.files);
      event.target.value = "";
    });
    for (const kind of ["dragenter", "dragover"])
      area.addEventListener(kind, (event) => (event.preventDefault(), area.classList.add("over")));
    area.addEventListener("dragleave", () => area.classList.remove("over"));
    area.addEventListener("drop", (event) => {
      event.preventDefault();
      event.stopPropagation();
      area.classList.remove("over");
      take(role, event.dataTransfer.files);
    });
  }
  document.addEventListener("dragover", (event) => event.preventDefault()); // a miss must not leave the page
  document.addEventListener("drop", (event) => (event.preventDefault(), form.hidden || take("recording", event.dataTransfer.files)));

  // ---- a new job

  const say = (text) => ($("said").textContent = text);
  const fault = (text, field) => {
    if (field) field.setAttribute("aria-invalid", "true"), field.closest("details")?.setAttribute("open", "");
    if (field) field.focus();
    return new Error(text);
  };

  function numberOf(field, text = field.value.trim()) {
    if (field.validity.badInput) throw fault(`${labelOf(field)}: this is no number`, field);
    if (text === "") return null;
    const parts = text.replace(",", ".").split("/").map(Number);
    const value = parts.length === 2 ? parts[0] / parts[1] : parts[0];
    if (parts.length > 2 || !Number.isFinite(value)) throw fault(`${labelOf(field)}: ${text} is no number`, field);
    const { min, max } = field;
    if ((min && value < Number(min)) || (max && value > Number(max)))
      throw fault(`${labelOf(field)} must lie between ${min} and ${max}, and ${text} was given`, field);
    return value;
  }
  const labelOf = (field) => form.querySelector(`label[for="${field.id}"]`).firstChild.textContent.trim();

  async function options() {
    const found = { preset: $("preset").value };
    for (const field of form.querySelectorAll("input[data-option]")) {
      const value = field.closest("[hidden]") ? null : numberOf(field);
      if (value !== null) found[field.dataset.option] = value;
    }
    const exposure = numberOf($("exposure"));
    if (exposure !== null && exposure <= 0) throw fault("Exposure time must be above 0, such as 1/50", $("exposure"));
    if (exposure !== null) found["exposure.seconds"] = exposure;
    const lens = numberOf($("lens"));
    if (lens !== null) found["camera.focal_px"] = $("lens-kind").value === "px" ? lens : await focalOf(lens);
    return found;
  }

  async function focalOf(degrees) {
    if (!(degrees > 0 && degrees < 170)) throw fault("The field of view must lie between 0 and 170 degrees", $("lens"));
    const size = await sizes.get(chosen.recording[0]);
    if (!size) throw fault("This browser does not tell the picture's size: give the focal length in px", $("lens"));
    return Math.max(...size) / 2 / Math.tan((degrees * Math.PI) / 360);
  }

  async function checked() {
    const files = Object.entries(chosen).flatMap(([role, list]) => list.map((file) => ({ role, file })));
    if (!chosen.recording.length) throw fault("Give a blurred picture or a video first", $("recording"));
    if (!isVideo() && !chosen.plate.length) throw fault("Give a picture of the empty scene, too: the same view without the person", $("plate"));
    if (chosen.recording.length > limits.pictures) throw new Error(`${chosen.recording.length} pictures were given: give at most ${limits.pictures}, or a video`);
    if (files.reduce((sum, { file }) => sum + file.size, 0) > limits.bytes)
      throw new Error(`The files are larger than ${limits.bytes / 2 ** 30} GB together: cut the video, or use hfb video`);
    const plate = chosen.plate.length ? await sizes.get(chosen.plate[0]) : null;
    for (const file of [...chosen.plate, ...chosen.recording]) {
      const size = await sizes.get(file);
      if (size && size[0] * size[1] > limits.pixels)
        throw new Error(`${file.name} has ${size[0]} x ${size[1]} px: at most ${limits.pixels / 1e6} million are read, make it smaller`);
      if (size && plate && !VIDEO.test(file.name) && (size[0] !== plate[0] || size[1] !== plate[1]))
        throw new Error(`${file.name} is ${size.join(" x ")} px and the empty scene ${plate.join(" x ")} px: give one of the same camera at the same size`);
    }
    return files;
  }

  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    say("");
    for (const field of form.querySelectorAll("[aria-invalid]")) field.removeAttribute("aria-invalid");
    const start = form.querySelector("button.main");
    start.disabled = true;
    try {
      const files = await checked();
      const request = {
        files: files.map(({ role, file }) => ({ role, name: file.name.slice(-300), size: file.size })),
        background: $("still").value,
        options: await options(),
      };
      const job = await send(new Blob([`${JSON.stringify(request)}\n`, ...files.map(({ file }) => file)]));
      location.hash = job.name;
    } catch (error) {
      say(error.message.replace(/[^.]$/, "$&."));
    } finally {
      start.disabled = false;
      $("sent").hidden = true;
      $("sending").textContent = "";
    }
  });

  function send(body) {
    return new Promise((done, failed) => {
      const request = new XMLHttpRequest(); // it tells how much was sent
      request.open("POST", "jobs");
      request.setRequestHeader("Content-Type", limits.kind);
      request.responseType = "json";
      $("sent").hidden = false;
      $("sending").textContent = "copying";
      request.upload.addEventListener("progress", ({ loaded, total }) => ($("sent").value = loaded / total));
      request.addEventListener("load", () => {
        if (request.status === 201) done(request.response);
        else failed(new Error(request.response?.error || `the server answers ${request.status}`));
      });
      request.addEventListener("error", () => failed(new Error("The server does not answer, or a file cannot be read: is hfb app still running?")));
      request.send(body);
    });
  }

  // ---- one job, and the list of all

  let shownName = null, shownState = null, round = 0;
  const path = (name, rest = "") => `jobs/${encodeURIComponent(name)}${rest}`;
  const when = (job) => `${job.name.slice(0, 4)}-${job.name.slice(4, 6)}-${job.name.slice(6, 8)} ${job.name.slice(9, 11)}:${job.name.slice(11, 13)}`;

  function row(job) {
    const line = made("li"), link = made("a", "", { href: `#${job.name}` }), picture = made("span", "", { className: "look" });
    if (job.state === "done") picture.append(made("img", "", { src: path(job.name, "/strip"), alt: "", loading: "lazy" }));
    const name = made("span", job.title, { className: "name" });
    name.append(made("span", when(job), { className: "when muted" }));
    const [words, kind] = STATES[job.state];
    link.append(picture, name, made("span", words, { className: `state ${kind}` }));
    if (job.name === shownName) link.setAttribute("aria-current", "true");
    line.append(link);
    return line;
  }

  let listed = "";
  function list(jobs) {
    const now = JSON.stringify([shownName, jobs]);
    if (now === listed) return; // what a reader stands on stays
    listed = now;
    const focused = document.activeElement?.closest?.(".jobs a")?.getAttribute("href");
    $("none").hidden = jobs.length > 0;
    $("jobs").replaceChildren(...jobs.map(row));
    if (focused) $("jobs").querySelector(`a[href="${focused}"]`)?.focus();
  }

  function steps(job) {
    const now = job.steps.findLast((step) => step.state === "running");
    const bar = $("job-progress");
    if (now?.total) (bar.max = now.total), (bar.value = now.done);
    else bar.removeAttribute("value");
    $("job-steps").replaceChildren(
      ...job.steps.map((step) => {
        const count = step.state === "running" && step.total ? ` ${step.done} of ${step.total}` : "";
        const rest = step.state === "running" ? [count, step.note].filter(Boolean).join(", ") : ` ${step.seconds} s`;
        return made("li", `${step.label}${rest && !rest.startsWith(" ") ? " " : ""}${rest}`, { className: step.state });
      }),
    );
  }

  function figure(value, label) {
    const line = made("li");
    line.append(made("b", value), made("span", label));
    return line;
  }

  function frame(address) {
    const fresh = $("report").cloneNode(); // a new one leaves no entry in the history
    fresh.removeAttribute("src");
    if (address) fresh.src = address;
    $("report").replaceWith(fresh);
  }

  function result(job) {
    const told = job.figures;
    const rows = [
      [told.matte_iou?.toFixed(3), "IoU with the matte"], [told.psnr_db?.toFixed(1), "image PSNR [dB]"],
      [told.frames, "frames"], [(told.fit_seconds ?? told.seconds)?.toFixed(0), "seconds"],
    ];
    $("job-figures").replaceChildren(...rows.filter(([value]) => value != null).map(([value, label]) => figure(String(value), label)));
    const warnings = (told.warnings || []).map(({ message }) => made("p", `Warning: ${message}.`, { className: "bad" }));
    $("job-warnings").replaceChildren(...warnings);
    $("report-link").href = path(job.name, "/report");
    const reported = "report.html" in job.files;
    $("report-part").hidden = !reported;
    frame(reported && path(job.name, "/report"));
    $("mlflow").hidden = !job.link;
    if (job.link) $("mlflow").querySelector("a").href = job.link;
    $("mlflow-hint").hidden = !/^https?:\/\/(127\.0\.0\.1|localhost)[:/]/.test(job.link || "");
    $("all").href = path(job.name, "/all");
    const order = Object.keys(ABOUT);
    const place = (name) => (order.includes(name) ? order.indexOf(name) : order.length);
    const files = Object.entries(job.files).sort(([one], [other]) => place(one) - place(other));
    $("files").replaceChildren(
      ...files.map(([name, size]) => {
        const line = made("tr"), cell = made("td");
        cell.append(made("a", name, { href: path(job.name, `/files/${encodeURIComponent(name)}`), download: name }));
        line.append(cell, made("td", ABOUT[name] || (name.startsWith("matte_") ? "the person's share of each pixel" : "")), made("td", bytes(size), { className: "size" }));
        return line;
      }),
    );
  }

  function show(job) {
    const active = ["waiting", "running", "cancelling"].includes(job.state);
    const [words] = STATES[job.state];
    $("job-title").textContent = job.title;
    const now = job.steps.findLast((step) => step.state === "running");
    const state = `${words}${job.state === "running" && now ? `: ${now.label}` : ""}`;
    if ($("job-state").textContent !== state) $("job-state").textContent = state; // else it is read out again and again
    if ($("job-message").textContent !== job.message) $("job-message").textContent = job.message;
    $("job-running").hidden = job.state === "waiting" || job.state === "done" || !job.steps.length;
    $("job-progress").hidden = !active;
    steps(job);
    const offered = { cancel: job.state === "waiting" || job.state === "running", again: !active && job.state !== "done", remove: !active };
    for (const button of $("job").querySelectorAll("[data-do]")) button.hidden = !offered[button.dataset.do];
    $("job-result").hidden = job.state !== "done";
    if (job.state === "done" && shownState !== "done") result(job);
    $("job-log").hidden = !job.log;
    const log = $("job-log").querySelector("pre");
    if (log.textContent !== job.log) log.textContent = job.log;
    shownState = job.state;
  }

  for (const button of $("job").querySelectorAll("[data-do]"))
    button.addEventListener("click", async () => {
      const name = shownName, what = button.dataset.do;
      if (what === "remove" && !confirm("Remove this recording, its result and all of its files?")) return;
      try {
        ++round; // nobody asks for what is being removed
        await ask(path(name, `/${what}`), "POST");
        if (what === "remove") return void (location.hash = "");
        $("job-title").focus();
        await look_again();
      } catch (error) {
        await look_again();
        $("job-message").textContent = error.message;
      }
    });

  async function look_again() {
    const mine = ++round;
    let pause = 5000;
    try {
      const [jobs, job] = await Promise.all([ask("jobs"), shownName ? ask(path(shownName)) : null]);
      if (mine !== round) return;
      list(jobs);
      if (job) show(job);
      if (jobs.some(({ state }) => ["waiting", "running", "cancelling"].includes(state))) pause = 500;
    } catch (error) {
      if (mine !== round) return;
      const text = error instanceof TypeError ? "The server does not answer: is hfb app still running?" : error.message;
      (shownName ? $("job-message") : $("said")).textContent = text;
    }
    setTimeout(() => mine === round && look_again(), pause);
  }

  function turn() {
    const name = location.hash.slice(1), moved = name !== (shownName || "");
    shownName = name || null;
    shownState = null;
    form.hidden = Boolean(name);
    $("job").hidden = !name;
    frame();
    for (const one of ["job-title", "job-state", "job-message"]) $(one).textContent = "";
    $("job-running").hidden = $("job-result").hidden = $("job-log").hidden = true;
    for (const button of $("job").querySelectorAll("[data-do]")) button.hidden = true;
    if (moved) window.scrollTo(0, 0), (name ? $("job-title") : form.querySelector("h2")).focus();
    look_again();
  }
  window.addEventListener("hashchange", turn);
  draw();
  turn();
}
