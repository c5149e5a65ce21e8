// rdflib.js: its Fetcher reads pages and writes documents, its UpdateManager patches them.
import assert from "node:assert/strict";
import * as rdf from "rdflib";
import { fails, put } from "./checks.mjs";

const P = rdf.sym("http://example.org/p");

function opened() {
    const store = rdf.graph();
    const fetcher = new rdf.Fetcher(store);
    return { store, fetcher, updater: new rdf.UpdateManager(store) };
}

/** What a document says of itself, as somebody else reads it. */
async function values(url) {
    const { store, fetcher } = opened();
    await fetcher.load(url);
    return store.each(rdf.sym(url), P, undefined, rdf.sym(url)).map((node) => node.value).sort();
}

const says = (url, value) => rdf.st(rdf.sym(url), P, rdf.lit(value), rdf.sym(url));

export async function run(url, checks) {
    const container = `${url}data/rdflib/`;
    let counter = 0;
    const fresh = () => `${container}r${++counter}`;

    await checks.check("Fetcher.load of a page", async () => {
        const { store, fetcher } = opened();
        const topic = rdf.sym(`${url}topics/aircraft/engine/speed`);
        await fetcher.load(topic);
        assert.equal(store.any(topic, rdf.sym("https://w3id.org/rosld#name")).value, "/aircraft/engine/speed");
    });
    await checks.check("Fetcher.load of what does not exist", async () => {
        await fails("Not Found", () => opened().fetcher.load(`${container}none`));
    });
    await checks.check("Fetcher.createContainer", async () => {
        const answer = await opened().fetcher.createContainer(`${url}data/`, "rdflib");
        assert.ok(answer.ok, String(answer.status));
    });
    await checks.check("Fetcher.webOperation PUT and DELETE", async () => {
        const target = fresh();
        const { fetcher } = opened();
        await fetcher.webOperation("PUT", target, { data: `<> <${P.value}> 'a' .`, contentType: "text/turtle" });
        assert.deepEqual(await values(target), ["a"]);
        await fetcher.webOperation("DELETE", target);
        await fails("Fetcher", () => values(target));
    });
    await checks.check("Fetcher.putBack", async () => {
        const target = fresh();
        await put(target, `<> <${P.value}> 'a' .`);
        const { store, fetcher } = opened();
        await fetcher.load(target);
        store.add(says(target, "b"));
        await fetcher.putBack(target);
        assert.deepEqual(await values(target), ["a", "b"]);
    });
    await checks.check("UpdateManager.editable of a document", async () => {
        const target = fresh();
        await put(target, "");
        const { fetcher, updater } = opened();
        await fetcher.load(target);
        assert.ok(updater.editable(target), String(updater.editable(target)));
    });
    await checks.check("UpdateManager.update of a document", async () => {
        const target = fresh();
        await put(target, `<> <${P.value}> 'a' .`);
        const { store, fetcher, updater } = opened();
        await fetcher.load(target);
        await updater.update(store.statementsMatching(rdf.sym(target), P), [says(target, "b"), says(target, "ä\n")]);
        assert.deepEqual(await values(target), ["b", "ä\n"]);
    });
    await checks.check("UpdateManager.update with blank nodes", async () => {
        const target = fresh();
        await put(target, `<> <${P.value}> [ <${P.value}> 'inside' ] .`);
        const { store, fetcher, updater } = opened();
        await fetcher.load(target);
        const inner = store.any(rdf.sym(target), P);
        await updater.update(store.statementsMatching(inner, P), [rdf.st(inner, P, rdf.lit("changed"), rdf.sym(target))]);
        const again = opened();
        await again.fetcher.load(target);
        assert.equal(again.store.any(again.store.any(rdf.sym(target), P), P).value, "changed");
    });
    await checks.check("UpdateManager.update of a document that does not exist makes it", async () => {
        const target = fresh();
        const { fetcher, updater } = opened();
        await fetcher.load(target).catch(() => {});
        await updater.update([], [says(target, "made")]);
        assert.deepEqual(await values(target), ["made"]);
    });
    await checks.check("UpdateManager.put of a new document", async () => {
        const target = fresh();
        const { updater } = opened();
        await new Promise((done, refused) => {
            updater.put(rdf.sym(target), [says(target, "put")], "text/turtle", (_, ok, error) => (ok ? done() : refused(new Error(error))));
        });
        assert.deepEqual(await values(target), ["put"]);
    });
    await checks.check("UpdateManager.updateMany of two documents", async () => {
        const [one, two] = [fresh(), fresh()];
        await put(one, "");
        await put(two, `<> <${P.value}> 'old' .`);
        const { store, fetcher, updater } = opened();
        await fetcher.load([rdf.sym(one), rdf.sym(two)]);
        await updater.updateMany(store.statementsMatching(rdf.sym(two), P), [says(one, "1"), says(two, "2")]);
        assert.deepEqual([await values(one), await values(two)], [["1"], ["2"]]);
    });
    await checks.check("UpdateManager.update after DELETE makes it again", async () => {
        const target = fresh();
        await put(target, `<> <${P.value}> 'a' .`);
        await opened().fetcher.webOperation("DELETE", target);
        const { fetcher, updater } = opened();
        await fetcher.load(target).catch(() => {});
        await updater.update([], [says(target, "again")]);
        assert.deepEqual(await values(target), ["again"]);
    });
    await checks.check("UpdateManager.update of the robot", async () => {
        const night = rdf.sym(`${url}resources/cockpit/night`);
        const value = rdf.sym("http://www.w3.org/1999/02/22-rdf-syntax-ns#value");
        for (const wanted of [true, false]) {
            const { store, fetcher, updater } = opened();
            await fetcher.load(night);
            const old = store.statementsMatching(night, value, undefined, night.doc());
            await updater.update(old, [rdf.st(night, value, rdf.lit(String(wanted), undefined, rdf.sym("http://www.w3.org/2001/XMLSchema#boolean")), night.doc())]);
            const seen = await fetch(night.value, { headers: { Accept: "application/json" } });
            assert.equal(await seen.json(), wanted);
        }
    });
    await checks.check("a query is answered over what was loaded", async () => {
        const { store, fetcher } = opened();
        await fetcher.load(`${url}topics/`);
        assert.ok(store.each(rdf.sym(`${url}topics/`), rdf.sym("http://www.w3.org/ns/ldp#contains")).length > 0);
    });
}
