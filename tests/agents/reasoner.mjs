// Carries out what follows from rules: node reasoner.mjs ENTRY RULES [FACTS [ROUNDS]]
//
// In rounds: the EYE reasoner is given the rules and what was read, and derives requests; these are carried out over
// HTTP, and what they answer is what the next round reasons on. It ends when no request follows, and fails after so many
// rounds. It knows nothing of aircraft. Each write and each new thing to remember is printed as a line of JSON.
import { readFileSync } from "node:fs";
import eye from "eyereasoner";

const PILOT = "http://example.org/pilot#";
const RDF_TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type";
const HTV = "http://www.w3.org/2011/http#";
const HCTL = "https://www.w3.org/2019/wot/hypermedia#";
const QUERY = `{ ?request a <${HTV}Request> ; ?term ?value } => { ?request ?term ?value } .
               { <${PILOT}flight> <${PILOT}has> ?what } => { <${PILOT}flight> <${PILOT}has> ?what } .`;
const PAUSE_MS = 100;

const tell = (line) => console.log(JSON.stringify(line));

/** What follows from documents of N3: the requests, and what is to be remembered. */
async function derived(documents) {
    const quads = await eye.n3reasoner(documents, QUERY, { outputType: "quads" });
    const requests = new Map();
    for (const { subject, predicate, object } of quads) {
        if (subject.value === `${PILOT}flight`) continue;
        if (!requests.has(subject.value)) requests.set(subject.value, {});
        requests.get(subject.value)[predicate.value] = object.value;
    }
    const all = [...requests.values()]
        .filter((terms) => terms[RDF_TYPE] === `${HTV}Request`)
        .map((terms) => ({
            method: terms[`${HTV}methodName`],
            target: terms[`${HCTL}hasTarget`],
            type: terms[`${HCTL}forContentType`],
            body: terms[`${HTV}body`],
        }));
    const distinct = [...new Map(all.map((request) => [JSON.stringify(request), request])).values()];
    const remembered = quads.filter((quad) => quad.subject.value === `${PILOT}flight`).map((quad) => quad.object.value);
    return { requests: distinct, remembered: [...new Set(remembered)] };
}

/** The resource as it was read: its Turtle if it has some, and the status. */
async function read(url) {
    const answer = await fetch(url, { headers: { Accept: "text/turtle" } });
    const text = await answer.text();
    return `@base <${url}> .\n${answer.ok ? text : ""}\n<${url}> <${PILOT}answered> ${answer.status} .\n`;
}

/** Carry out an unsafe request. What is refused is told and left: the next round sees why it was no longer on offer. */
async function write({ method, target, type, body }) {
    const headers = body === undefined ? {} : { "Content-Type": type };
    const answer = await fetch(target, { method, body, headers: { Accept: "text/turtle", ...headers } });
    await answer.arrayBuffer();
    tell({ method, target, body, status: answer.status });
}

const [entry, rules, facts = "", rounds = "300"] = process.argv.slice(2);
const known = new Map([[entry, await read(entry)]]);
let memory = [];
for (let round = 0; round < Number(rounds); round += 1) {
    const remembering = memory.map((what) => `<${PILOT}flight> <${PILOT}has> <${what}> .`).join("\n");
    const { requests, remembered } = await derived([readFileSync(rules, "utf8"), facts, remembering, ...known.values()]);
    for (const what of remembered) if (!memory.includes(what)) tell({ remembered: what });
    memory = remembered;
    if (requests.length === 0) process.exit(0);
    for (const request of requests) if (request.method !== "GET") await write(request);
    for (const { method, target } of requests) if (method === "GET") known.set(target, await read(target));
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
}
console.error(`no end after ${rounds} rounds`);
process.exit(1);
