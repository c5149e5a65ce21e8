/* What can be written next in a query: this server's prefixes, its properties and classes, and what the robot has.

All of it comes from this server, by one query, once somebody begins to type. */
"use strict";
const queryTerms = (() => {
  const FRAGMENT = /(<[^<>"{}|^`\\\s]*|[\w-]*:[\w.-]*|[A-Za-z_][\w-]*)$/;
  const DECLARATION = /^\s*PREFIX\s+([\w-]*)(:?\s*<?[^<>\s]*)$/i;
  const LOCAL = /^\w[\w-]*$/;
  const MOST = 100; // that are shown
  const QUERY = `SELECT DISTINCT ?kind ?term WHERE {
    { ?s ?term ?o BIND("property" AS ?kind) } UNION { ?term a rdf:Property BIND("property" AS ?kind) }
    UNION { ?s a ?term BIND("class" AS ?kind) } UNION { ?term a rdfs:Class BIND("class" AS ?kind) }
    UNION { ?term a ros:Topic BIND("resource" AS ?kind) } UNION { ?term a ros:Node BIND("resource" AS ?kind) }
    UNION { ?term a ros:Service BIND("resource" AS ?kind) } UNION { ?term a ros:Action BIND("resource" AS ?kind) }
  } LIMIT 20000`;

  /* Teaches YASQE (a class) and the editor (one of it) these terms. `names` says how IRIs are written. */
  function complete(Yasqe, editor, names) {
    let found = null;
    const terms = () => found ??= load(names).catch(() => { found = null; return { property: [], class: [], resource: [] }; });

    Yasqe.Autocompleters.terms = {
      name: "terms",
      bulk: false,
      isValidCompletionPosition: (yasqe) => fragment(yasqe) !== null,
      preProcessToken: (yasqe, token) => ({ ...token, ...fragment(yasqe) }),
      get: async (yasqe, token) => token?.from ? suggest(yasqe, token, await terms(), names) : [],
    };
    editor.enableCompleter("terms");
    editor.on("changes", (_, changes) => {
      if (!changes.some(({ origin }) => origin === "+input")) return;
      const typed = fragment(editor);
      if (typed?.string.includes(":")) declare(editor, typed, names.prefixes);
      if (typed && /[:<]/.test(typed.string) && !editor.state.completionActive) editor.autocomplete();
    });
    editor.on("focus", terms);
  }

  /* What is being written before the cursor; null where there is nothing to complete. */
  function fragment(yasqe) {
    const { line, ch } = yasqe.getDoc().getCursor(), before = yasqe.getDoc().getLine(line).slice(0, ch);
    const string = (DECLARATION.exec(before)?.slice(1).join("") ?? FRAGMENT.exec(before)?.[0]) || null;
    if (string === null || /#(?![^<]*$)/.test(before.replace(/<[^<>\s]*>?/g, "")) || /[?$]$/.test(before.slice(0, -string.length))) return null;
    const start = ch - string.length;
    return { string, autocompletionString: string, start, end: ch, from: { line, ch: start }, to: { line, ch } };
  }

  async function load({ endpoint, terms }) {
    const answer = await fetch(`${endpoint}?query=${encodeURIComponent(QUERY)}`, { headers: { accept: "application/sparql-results+json" } });
    if (!answer.ok) throw new Error(answer.statusText);
    const found = { property: [], class: [], resource: [] };
    for (const { kind, term } of (await answer.json()).results.bindings) {
      if (kind && term?.type === "uri") found[kind.value].push(term.value);
    }
    for (const list of Object.values(found)) list.sort();
    return found;
  }

  function suggest(yasqe, { string, from }, terms, names) {
    const line = yasqe.getDoc().getLine(from.line);
    if (DECLARATION.test(line.slice(0, from.ch + string.length))) return declarations(string, terms, names);
    const lists = order(yasqe, from, line, terms);
    const write = string.startsWith("<") ? inBrackets(string.slice(1), names) : withPrefix(string, prefixesOf(yasqe, names));
    const texts = new Map(); // by their ranks: what begins so is before what holds it
    for (const iri of lists.flat()) {
      const [text, rank] = write(iri) ?? [];
      if (text && text !== string) texts.set(text, Math.min(rank, texts.get(text) ?? rank));
    }
    return [...texts.keys()].sort((one, other) => texts.get(one) - texts.get(other)).slice(0, MOST);
  }

  /* The lists of terms that may stand there, the likeliest first. */
  function order(yasqe, from, line, terms) {
    if (/(^|[\s;{.,])(a|rdf:type)\s+$/.test(line.slice(0, from.ch))) return [terms.class];
    const { state } = yasqe.getTokenAt({ line: from.line, ch: from.ch + 1 }, true);
    if (state.possibleCurrent?.includes("a")) return [terms.property];
    return [terms.resource, terms.class, terms.property];
  }

  const inBrackets = (typed, { base }) => (iri) => {
    if (iri.startsWith(typed) && typed) return [`<${iri}>`, 0];
    if (iri.startsWith(base) && iri.slice(base.length).startsWith(typed)) return [`<${iri.slice(base.length)}>`, 0];
    return typed && iri.toLowerCase().includes(typed.toLowerCase()) ? [`<${iri.startsWith(base) ? iri.slice(base.length) : iri}>`, 1] : null;
  };

  const withPrefix = (string, prefixes) => {
    const [prefix, local] = string.includes(":") ? string.split(":") : [null, string];
    const wanted = local.toLowerCase();
    return (iri) => {
      for (const [name, namespace] of prefix === null ? Object.entries(prefixes) : [[prefix, prefixes[prefix]]]) {
        if (!namespace || !iri.startsWith(namespace)) continue;
        const rest = iri.slice(namespace.length), at = rest.toLowerCase().indexOf(wanted);
        if (LOCAL.test(rest) && at >= 0) return [`${name}:${rest}`, Math.min(at, 1)];
      }
      if (prefix !== null) return null;
      return iri.slice(Math.max(iri.lastIndexOf("#"), iri.lastIndexOf("/")) + 1).toLowerCase().startsWith(wanted) ? [`<${iri}>`, 2] : null;
    };
  };

  const prefixesOf = (yasqe, { prefixes }) => ({ ...prefixes, ...yasqe.getPrefixesFromQuery() });

  /* Namespaces to declare: those of the server, and of the message types that it knows. */
  function declarations(string, terms, { prefixes, types }) {
    const ofTypes = terms.class.filter((iri) => iri.startsWith(types)).map((iri) => {
      const name = iri.slice(iri.lastIndexOf("/") + 1);
      return [name[0].toLowerCase() + name.slice(1), `${iri}#`];
    });
    const wanted = string.replace(/[:\s<].*/, "").toLowerCase();
    return [...Object.entries(prefixes), ...ofTypes]
      .filter(([name]) => name.toLowerCase().startsWith(wanted))
      .map(([name, namespace]) => `${name}: <${namespace}>`)
      .slice(0, MOST);
  }

  /* A prefix of the server that is used for the first time is declared, so that the query holds elsewhere, too. */
  function declare(yasqe, { string, from }, prefixes) {
    const [name] = string.split(":"), document = yasqe.getDoc(), text = document.getValue();
    const isDeclared = new RegExp(`^\\s*PREFIX\\s+${name}:`, "im").test(text);
    if (!Object.hasOwn(prefixes, name) || isDeclared || string.startsWith("<")) return;
    if (DECLARATION.test(document.getLine(from.line).slice(0, from.ch + string.length))) return;
    if (yasqe.getTokenAt({ line: from.line, ch: from.ch + 1 }).type === "string") return;
    const lines = text.split("\n");
    let at = lines.findLastIndex((each) => /^\s*(PREFIX|BASE)\b/i.test(each)) + 1;
    if (at === 0) at = Math.max(lines.findIndex((each) => !/^\s*#/.test(each)), 0);
    document.replaceRange(`PREFIX ${name}: <${prefixes[name]}>\n`, { line: at, ch: 0 }, undefined, "+prefix");
  }

  /* The server's prefixes hold without being declared: the grammar of the editor learns that. */
  function know(editor, prefixes) {
    const mode = editor.getMode(), begin = mode.startState;
    mode.startState = (...rest) => ({ ...begin(...rest), prefixes: { ...prefixes } });
    editor.setValue(editor.getValue());
    editor.getDoc().clearHistory();
  }

  return { complete, know };
})();
