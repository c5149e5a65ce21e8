// jsonld.js: pages as it reads them, through its own loader of documents, and what it writes.
import assert from "node:assert/strict";
import jsonld from "jsonld";
import { PAGES, put, read } from "./checks.mjs";

const P = "http://example.org/p";
const XSD = "http://www.w3.org/2001/XMLSchema#";

export async function run(url, checks) {
    const graph = `${url}data/jsonld`;

    await checks.check("pages are understood", async () => {
        const failed = [];
        for (const path of PAGES.filter((path) => path !== "queries/inventory")) { // which answers as JSON, and no JSON-LD
            try {
                const found = await jsonld.canonize(url + path, { algorithm: "RDFC-1.0", format: "application/n-quads" });
                assert.notEqual(found, "", "no triples");
            } catch (error) {
                failed.push(`/${path}: ${error.message} ${JSON.stringify(error.details ?? "")}`);
            }
        }
        assert.deepEqual(failed, []);
    });
    await checks.check("a page is expanded, compacted, flattened and framed", async () => {
        const page = `${url}topics/aircraft/engine/speed`;
        const [expanded] = await jsonld.expand(page);
        assert.equal(expanded["@id"], page);
        const context = { name: "https://w3id.org/rosld#name" };
        assert.equal((await jsonld.compact(page, context)).name ?? (await jsonld.flatten(page, context))["@graph"].find((node) => node.name).name, "/aircraft/engine/speed");
        const framed = await jsonld.frame(page, { "@context": context, "@id": page });
        assert.equal(framed.name, "/aircraft/engine/speed");
    });
    await checks.check("what it makes from RDF is put and read again", async () => {
        const text = `<${graph}> <${P}> "\\u00E4"@de .\n<${graph}> <${P}> "7"^^<${XSD}integer> .\n<${graph}> <${P}> _:b .\n_:b <${P}> "x" .\n`;
        const document = await jsonld.fromRDF(text, { format: "application/n-quads" });
        await put(graph, JSON.stringify(document), "application/ld+json");
        const quads = await jsonld.toRDF(graph);
        assert.deepEqual(quads.filter((quad) => quad.predicate.value === P && quad.object.termType === "Literal").map((quad) => quad.object.value).sort(), ["7", "x", "\u00e4"]);
        assert.match((await read(graph)).text, /"\\u00E4"@de|"ä"@de/);
    });
    await checks.check("a context within the document is understood", async () => {
        const document = { "@context": { "@vocab": "http://example.org/", p: { "@type": "xsd:date" }, xsd: XSD }, "@id": "", p: "2026-11-22", q: [1, 2.5, true] };
        await put(`${graph}-context`, JSON.stringify(document), "application/ld+json");
        assert.match((await read(`${graph}-context`)).text, /"2026-11-22"\^\^/);
    });
    const values = ["0.1", "1.0E100", "-0.0", "12345678901234567890.0", "0.30000000000000004", "INF", "-INF", "NaN", "5e-324"];
    await checks.check("numbers are read as N-Triples say them", async () => {
        await put(`${graph}-numbers`, values.map((value) => `<> <${P}> "${value}"^^<${XSD}double> .`).join("\n"));
        const [node] = await jsonld.expand(`${graph}-numbers`);
        assert.deepEqual(node[P].map((one) => one["@value"]).sort(), [...values].sort());
        assert.deepEqual(new Set(node[P].map((one) => one["@type"])), new Set([`${XSD}double`]));
    });
    await checks.check("numbers become RDF with the sixteen digits that it keeps", async () => {
        // jsonld.js reads every xsd:double as a number of JavaScript, also from a string, and writes sixteen digits of it;
        // INF is none of these numbers, and -0 has no sign in what it writes. No form of JSON-LD escapes that.
        const quads = (await jsonld.toRDF(`${graph}-numbers`)).filter((quad) => quad.predicate.value === P);
        const kept = (text) => Number(Number(text).toPrecision(16)) + 0;
        const finite = (texts) => texts.map(kept).filter(Number.isFinite).sort((a, b) => a - b);
        assert.deepEqual(finite(quads.map((quad) => quad.object.value)), finite(values));
        assert.deepEqual(new Set(quads.map((quad) => quad.object.datatype.value)), new Set([`${XSD}double`]));
    });
}
