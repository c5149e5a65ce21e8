// Comunica: queries over pages, over the endpoint, over both; updates of the endpoint and of documents.
import assert from "node:assert/strict";
import { QueryEngine } from "@comunica/query-sparql";
import { PAGES, fails, put, read } from "./checks.mjs";

const P = "http://example.org/p";
const XSD = "http://www.w3.org/2001/XMLSchema#";

export async function run(url, checks) {
    const engine = new QueryEngine();
    const endpoint = { type: "sparql", value: `${url}sparql` };
    let counter = 0;
    const fresh = () => `${url}data/comunica/c${++counter}`;
    const select = async (query, ...sources) => {
        const rows = await (await engine.queryBindings(query, { sources })).toArray();
        return rows.map((row) => Object.fromEntries([...row].map(([variable, term]) => [variable.value, term.value])));
    };
    const objects = async (query, ...sources) => (await select(query, ...sources)).map((row) => row.o).sort();
    const forget = () => engine.invalidateHttpCache();

    await checks.check("a page", async () => {
        const topic = `${url}topics/aircraft/engine/speed`;
        assert.deepEqual(await objects(`SELECT ?o { <${topic}> <https://w3id.org/rosld#name> ?o }`, topic), ["/aircraft/engine/speed"]);
    });
    await checks.check("pages of all kinds", async () => {
        const failed = [];
        for (const path of PAGES) {
            try {
                assert.notEqual((await select("SELECT * { ?s ?p ?o } LIMIT 3", url + path)).length, 0, "nothing");
            } catch (error) {
                failed.push(`/${path}: ${String(error).slice(0, 300)}`);
            }
        }
        assert.deepEqual(failed, []);
    });
    await checks.check("several pages", async () => {
        const rows = await select("SELECT DISTINCT ?c { ?c <http://www.w3.org/ns/ldp#contains> ?m }", `${url}topics/`, `${url}nodes/`);
        assert.equal(rows.length, 2);
    });
    await checks.check("a document that was put", async () => {
        const target = fresh();
        await put(target, `<> <${P}> 'ä', 7, 0.1e0, [ <${P}> 'inside' ] .`);
        assert.deepEqual((await objects(`SELECT ?o { <${target}> <${P}> ?o FILTER(isLiteral(?o)) }`, target)).length, 3);
        assert.deepEqual(await objects(`SELECT ?o { <${target}> <${P}>/<${P}> ?o }`, target), ["inside"]);
    });
    await checks.check("the endpoint, said to be one", async () => {
        assert.ok((await objects("SELECT ?o { ?s <https://w3id.org/rosld#name> ?o }", endpoint)).length > 5);
    });
    await checks.check("the endpoint, found to be one", async () => {
        assert.ok((await objects("SELECT ?o { ?s <https://w3id.org/rosld#name> ?o }", `${url}sparql`)).length > 5);
    });
    await checks.check("joins, OPTIONAL, FILTER, paths and aggregates over the endpoint", async () => {
        const rows = await select(
            `PREFIX ros: <https://w3id.org/rosld#> SELECT ?node (COUNT(?topic) AS ?n) {
                ?node ros:publishes ?topic . ?topic ros:name ?name . OPTIONAL { ?topic ros:none ?x } FILTER(STRLEN(?name) > 1)
            } GROUP BY ?node`,
            endpoint,
        );
        assert.ok(rows.length > 0 && Number(rows[0].n) > 0, JSON.stringify(rows));
    });
    await checks.check("named graphs of the endpoint", async () => {
        const target = fresh();
        await put(target, `<> <${P}> 'a' .`);
        assert.deepEqual(await objects(`SELECT ?o { GRAPH <${target}> { ?s <${P}> ?o } }`, endpoint), ["a"]);
        const rows = await select(`SELECT ?g { GRAPH ?g { <${target}> <${P}> 'a' } }`, endpoint);
        assert.deepEqual(rows.map((row) => row.g), [target]);
    });
    await checks.check("ASK", async () => {
        assert.equal(await engine.queryBoolean("ASK { ?s ?p ?o }", { sources: [endpoint] }), true);
        assert.equal(await engine.queryBoolean("ASK { <urn:none> ?p ?o }", { sources: [endpoint] }), false);
    });
    await checks.check("CONSTRUCT and DESCRIBE", async () => {
        const topic = `${url}topics/aircraft/engine/speed`;
        const made = await (await engine.queryQuads(`CONSTRUCT { ?s ?p ?o } { GRAPH <${topic}> { ?s ?p ?o } }`, { sources: [endpoint] })).toArray();
        assert.ok(made.length > 5, String(made.length));
        const described = await (await engine.queryQuads(`DESCRIBE <${topic}>`, { sources: [endpoint] })).toArray();
        assert.ok(described.length > 3, String(described.length));
    });
    await checks.check("literals are as they are told", async () => {
        const rows = await (await engine.queryBindings("SELECT * { VALUES ?o { 'ä'@de 7 true '\"\\n' 1.5 } }", { sources: [endpoint] })).toArray();
        const found = rows.map((row) => `${row.get("o").value}|${row.get("o").language}|${row.get("o").datatype.value.replace(XSD, "")}`);
        assert.equal(found.length, 5);
        assert.ok(found.includes("7||integer"), String(found));
    });
    await checks.check("a page joined with the endpoint", async () => {
        const target = fresh();
        await put(target, `<> <${P}> <${url}topics/aircraft/engine/speed> .`);
        const query = `SELECT ?o { <${target}> <${P}> ?topic . ?topic <https://w3id.org/rosld#name> ?o }`;
        assert.deepEqual([...new Set(await objects(query, target, endpoint))], ["/aircraft/engine/speed"]);
    });
    await checks.check("SERVICE", async () => {
        const target = fresh();
        await put(target, `<> <${P}> <${url}topics/aircraft/engine/speed> .`);
        const query = `SELECT ?o { <${target}> <${P}> ?topic . SERVICE <${url}sparql> { ?topic <https://w3id.org/rosld#name> ?o } }`;
        assert.deepEqual([...new Set(await objects(query, target))], ["/aircraft/engine/speed"]);
    });
    await checks.check("links are followed from page to page", async () => {
        const rows = await select("SELECT ?m { ?c <http://www.w3.org/ns/ldp#contains> ?m }", `${url}topics/`);
        const pages = rows.map((row) => row.m).filter((member) => !member.includes("#")).slice(0, 3);
        assert.ok((await select("SELECT ?s { ?s a ?type }", ...pages)).length >= pages.length);
    });
    await checks.check("an update of the endpoint", async () => {
        const target = fresh();
        const context = { sources: [endpoint], destination: endpoint };
        await engine.queryVoid(`INSERT DATA { GRAPH <${target}> { <${target}> <${P}> 'a' } }`, context);
        await engine.queryVoid(
            `DELETE { GRAPH <${target}> { ?s ?p 'a' } } INSERT { GRAPH <${target}> { ?s ?p 'b' } } WHERE { GRAPH <${target}> { ?s ?p 'a' } }`,
            context,
        );
        assert.match((await read(target)).text, /"b"/);
    });
    await checks.check("a refused update of the endpoint is an error", async () => {
        const query = `INSERT DATA { GRAPH <${url}topics/aircraft/engine/speed> { <urn:s> <${P}> 1 } }`;
        await fails("403", () => engine.queryVoid(query, { sources: [endpoint], destination: endpoint }));
    });
    await checks.check("an update of a document", async () => {
        const target = fresh();
        await put(target, `<> <${P}> 'a' .`);
        await engine.queryVoid(`INSERT DATA { <${target}> <${P}> 'b' }`, { sources: [target], destination: target });
        await forget();
        await engine.queryVoid(`DELETE { ?s <${P}> 'a' } INSERT { ?s <${P}> 'c' } WHERE { ?s <${P}> 'a' }`, { sources: [target], destination: target });
        await forget();
        assert.deepEqual(await objects(`SELECT ?o { <${target}> <${P}> ?o }`, target), ["b", "c"]);
    });
    await checks.check("an update of a document that does not exist makes it", async () => {
        const target = fresh();
        await engine.queryVoid(`INSERT DATA { <${target}> <${P}> 'made' }`, { sources: [`${url}topics/`], destination: target });
        assert.match((await read(target)).text, /"made"/);
    });
    await checks.check("an update of a document that was deleted makes it again", async () => {
        const target = fresh();
        await put(target, `<> <${P}> 'a' .`);
        await fetch(target, { method: "DELETE" });
        await engine.queryVoid(`INSERT DATA { <${target}> <${P}> 'again' }`, { sources: [`${url}topics/`], destination: target });
        assert.match((await read(target)).text, /"again"/);
    });
}
