/* Makes of the form at /sparql an editor with results beside it, by means of YASGUI's YASQE and YASR.

Its endpoint is this server's, and nothing is asked of another. Without this file, or with scripts off, the form asks the same. */
"use strict";
{
  const { Yasqe, Yasr } = Yasgui;
  const LONGEST = 4000; // characters of a query that stands in an address
  const VIEWS = { "#table": "table", "#plot": "Plot", "#links": "Links", "#response": "response" };
  const ROOMS = /^(nodes|topics|services|actions|parameters|resources)\/(.+)$/; // whose members are ROS names
  const root = document.getElementById("editor"), settings = JSON.parse(root.dataset.editor);
  const element = (name) => root.querySelector(`[data-part=${name}]`);
  const form = document.getElementById("ask"), box = form.querySelector("textarea");
  const parameters = element("parameters"), run = element("run"), partial = element("partial"), words = element("status"), stored = element("stored");
  const endpoint = new URL(settings.endpoint, location.href).href;
  const names = { ...settings, endpoint };

  /* How IRIs are shown and linked */

  const readable = (path) => { try { return decodeURIComponent(path); } catch { return path; } };

  function short(iri) {
    if (iri.startsWith(settings.types)) return readable(iri.slice(settings.types.length)) || iri;
    if (iri.startsWith(settings.base)) {
      const path = iri.slice(settings.base.length), name = ROOMS.exec(path);
      return readable(name ? `/${name[2]}` : path || "/");
    }
    const known = Object.entries(settings.prefixes).find(([, namespace]) => iri.startsWith(namespace) && iri !== namespace);
    return known ? `${known[0]}:${iri.slice(known[1].length)}` : iri;
  }

  const homes = new Map(Object.entries(settings.terms).flatMap(([path, named]) => named.map((name) => [name, path])));

  function href(iri) {
    if (!/^https?:\/\/[^\s\\]*$/i.test(iri)) return null;
    if (iri.startsWith(settings.base)) return settings.root + iri.slice(settings.base.length).replace(/^\/+/, "");
    if (iri.startsWith(settings.types)) return `${settings.root}types/${iri.slice(settings.types.length)}`;
    const name = short(iri);
    return homes.has(name) ? `${settings.root}${homes.get(name)}#${iri.split("#")[1]}` : iri;
  }

  /* The editor */

  Yasqe.defaults.autocompleters = ["variables"];
  for (const name of ["prefixes", "property", "class"]) delete Yasqe.Autocompleters[name];
  element("query").replaceChildren();
  root.hidden = false;
  form.hidden = true;
  partial.checked = form.elements.partial.checked;
  const editor = new Yasqe(element("query"), {
    value: box.value,
    persistenceId: `rosld ${settings.base}`,
    consumeShareLink: null,
    createShareableLink: null,
    showQueryButton: false,
    editorHeight: "16rem",
    tabSize: 2,
    requestConfig: {
      endpoint,
      method: (yasqe) => yasqe.getValue().length <= LONGEST ? "GET" : "POST",
      acceptHeaderSelect: "application/sparql-results+json",
      acceptHeaderGraph: "text/turtle",
      acceptHeaderUpdate: "application/json",
      args: (yasqe) => partial.checked && yasqe.getQueryMode() === "query" ? [{ name: "partial", value: "true" }] : [],
      adjustQueryBeforeRequest: (yasqe) => queryParameters.bind(parameters, yasqe.getValue(), settings.base),
    },
  });
  editor.getInputField().setAttribute("aria-label", "Query");
  editor.setOption("extraKeys", { ...editor.getOption("extraKeys"), Tab: false, "Shift-Tab": false }); // the focus goes on
  if (settings.isAsked) editor.setValue(box.value);
  queryTerms.know(editor, settings.prefixes);
  queryTerms.complete(Yasqe, editor, names);
  editor.on("change", () => queryParameters.draw(parameters, editor.getValue()));
  queryParameters.draw(parameters, editor.getValue());

  /* Stored queries */

  stored?.addEventListener("change", async () => {
    if (!stored.value) return;
    const answer = await fetch(stored.value, { headers: { accept: "application/sparql-query" } }).catch(() => null);
    if (!answer?.ok) return tell("The stored query cannot be read.");
    parameters.replaceChildren();
    delete parameters.dataset.drawn;
    editor.setValue((await answer.text()).trimEnd());
    editor.saveQuery();
    tell("");
    (parameters.querySelector("input") ?? editor).focus();
  });

  /* The results */

  Yasr.plugins.table.defaults.openIriInNewWindow = false;
  Yasr.registerPlugin("Plot", queryViews.plotView(short));
  Yasr.registerPlugin("Links", queryViews.linksView(short, href));
  const results = new Yasr(element("results"), {
    persistenceId: null,
    prefixes: settings.prefixes,
    pluginOrder: ["table", "Plot", "Links", "response"],
    plugins: { table: { enabled: true, dynamicConfig: { compact: true, isEllipsed: false } } },
    errorRenderers: [async ({ text }) => problem(text)],
  });
  results.rootEl.querySelector(".yasr_external_ref_btn")?.remove();
  for (const each of results.rootEl.querySelectorAll(".yasr_btnGroup button")) each.removeAttribute("aria-label");
  new MutationObserver(link).observe(results.resultsEl, { childList: true, subtree: true });

  /* Each IRI in the table is shown as on all pages, and leads to where this server describes it. */
  function link() {
    for (const each of results.resultsEl.querySelectorAll("a.iri:not([data-iri])")) {
      const iri = each.getAttribute("href"), target = href(iri);
      each.dataset.iri = iri;
      each.title = iri;
      each.textContent = short(iri);
      each.removeAttribute("target");
      if (target) each.href = target;
      else each.removeAttribute("href");
      each.parentElement.replaceChildren(each);
    }
  }

  /* What the server says is wrong (RFC 9457), in words. */
  function problem(text) {
    const whole = document.createElement("div"), head = document.createElement("p"), detail = document.createElement("p");
    let said = {};
    try { said = JSON.parse(text); } catch { said = { detail: text === "Failed to fetch" ? "The server does not answer." : text }; }
    whole.className = "notice error";
    whole.setAttribute("role", "alert");
    const isPlain = !said.type || said.type === "about:blank"; // whose title is but that of the status
    Object.assign(head, { className: "what", textContent: isPlain && said.detail ? "" : said.title ?? "" });
    detail.textContent = said.detail ?? "";
    whole.append(...[head, detail].filter((each) => each.textContent));
    return whole;
  }

  const tell = (text) => { words.textContent = text; };

  editor.on("query", () => {
    for (const each of document.querySelectorAll("main > .results, main > .notice.error:not(.stopped)")) each.hidden = true;
    run.textContent = "Cancel";
    tell("");
  });
  editor.on("queryAbort", () => { run.textContent = "Run"; tell("Cancelled."); });
  editor.on("queryResponse", (_, response, duration) => {
    run.textContent = "Run";
    if (response.name === "AbortError") return;
    element("results").hidden = response.status === 204;
    if (response.status === 204) return tell("Done: the update was carried out.");
    results.setResponse(response, duration);
    tell(unread(response.headers));
    remember();
  });

  function unread(headers) {
    const urls = [...(headers?.get("unread-graphs") ?? "").matchAll(/"([^"]+)"/g)].map(([, url]) => new URL(url).pathname);
    return urls.length ? `The answer is partial. Not read: ${urls.join(", ")}.` : "";
  }

  /* The address is that of the query and its view, to be handed on; an update never stands in it. */
  function remember() {
    if (editor.getQueryMode() !== "query") return;
    const text = queryParameters.bind(parameters, editor.getValue(), settings.base);
    const view = Object.keys(VIEWS).find((hash) => VIEWS[hash] === results.getSelectedPluginName()) ?? "";
    if (text.length <= LONGEST) history.replaceState(null, "", `?query=${encodeURIComponent(text)}${partial.checked ? "&partial=true" : ""}${view === "#table" ? "" : view}`);
  }
  results.on("change", () => { try { remember(); } catch { /* a parameter is wrong: the address stays */ } });

  const ask = () => editor.query().catch(() => {});
  run.addEventListener("click", () => run.textContent === "Run" ? ask() : editor.abortQuery());
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const paint = () => { document.documentElement.classList.toggle("dark", scheme.matches); results.draw(); };
  scheme.addEventListener("change", paint);
  paint();
  if (settings.isAsked && location.hash in VIEWS) {
    results.selectPlugin(VIEWS[location.hash]);
    if (editor.getQueryMode() === "query") ask(); // whoever follows a link must move nothing by it
  }
}
