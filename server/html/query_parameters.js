/* The parameters that a query declares in comments (`# @param NAME TYPE [DEFAULT] -- what it is`), as fields. */
"use strict";
const queryParameters = (() => {
  const DECLARATION = /^\s*#\s*@param\s+([A-Za-z]\w*)\s+(iri|string|integer|double)(?:\s+(.*?))??\s+--\s+(\S.*)$/gm;
  const TOKENS = /"""[^]*?"""|'''[^]*?'''|"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'|<[^<>"{}|^`\\\s]*>|#[^\n]*|[?$][\p{L}\p{N}_]+/gu;
  const XSD = "http://www.w3.org/2001/XMLSchema#";

  const declarations = (text) => [...text.matchAll(DECLARATION)].map(([, name, type, fallback, about]) => (
    { name, type, fallback: fallback === '""' ? "" : fallback ?? null, about: about.trim() }
  ));

  /* Draws the fields into `place` as far as they have changed; what was typed into those that stay is kept. */
  function draw(place, text) {
    const wanted = declarations(text), drawn = JSON.stringify(wanted);
    if (place.dataset.drawn === drawn) return;
    const typed = new Map([...place.querySelectorAll("input")].map((each) => [each.name, each.value]));
    place.dataset.drawn = drawn;
    place.replaceChildren(...wanted.map(({ name, fallback, about }) => {
      const row = document.createElement("p"), label = document.createElement("label"), input = document.createElement("input");
      const note = document.createElement("span");
      Object.assign(label, { htmlFor: `parameter-${name}`, textContent: name });
      Object.assign(input, { type: "text", id: label.htmlFor, name, autocomplete: "off", spellcheck: false });
      input.value = typed.get(name) ?? fallback ?? "";
      Object.assign(note, { className: "hint", id: `${label.htmlFor}-note`, textContent: about });
      input.setAttribute("aria-describedby", note.id);
      row.append(label, input, note);
      return row;
    }));
    place.hidden = !wanted.length;
  }

  /* The text with its parameters bound to what the fields hold. Throws an Error in words. */
  function bind(place, text, base) {
    const terms = new Map();
    for (const { name, type, fallback } of declarations(text)) {
      const typed = place.querySelector(`input[name="${name}"]`)?.value ?? "";
      const value = typed === "" && type !== "string" ? fallback : typed;
      if (value === null) throw new Error(`${name} must be given.`);
      terms.set(name, term(name, type, value, base));
    }
    return terms.size ? text.replace(TOKENS, (token) => terms.has(token.slice(1)) && /^[?$]/.test(token) ? ` ${terms.get(token.slice(1))} ` : token) : text;
  }

  function term(name, type, value, base) {
    const wrong = (what) => new Error(`${name}: ${value} is ${what}.`);
    if (type === "integer") {
      if (!/^\s*[+-]?\d+\s*$/.test(value)) throw wrong("not an integer such as 42");
      return `"${value.trim()}"^^<${XSD}integer>`;
    }
    if (type === "double") {
      if (!value.trim() || !Number.isFinite(Number(value))) throw wrong("not a number such as 2.5");
      return `"${value.trim()}"^^<${XSD}double>`;
    }
    if (type === "string") return JSON.stringify(value);
    const iri = value.startsWith("/") ? base + value.slice(1) : value;
    if (!/^[a-z][a-z0-9+.-]*:[^<>"{}|^`\\\x00-\x20]*$/i.test(iri)) throw wrong("neither an absolute IRI nor a path such as /topics/x");
    return `<${iri}>`;
  }

  return { draw, bind };
})();
