// Inrupt's solid-client, with the fetch of the platform.
import assert from "node:assert/strict";
import * as solid from "@inrupt/solid-client";
import { fails } from "./checks.mjs";

const P = "http://example.org/p";

/** A dataset with one thing that says this. */
function saying(dataset, url, value) {
    const thing = solid.addStringNoLocale(solid.getThing(dataset, url) ?? solid.createThing({ url }), P, value);
    return solid.setThing(dataset, thing);
}

const values = (dataset, url) => solid.getStringNoLocaleAll(solid.getThing(dataset, url), P).sort();

export async function run(url, checks) {
    const container = `${url}data/solid/`;
    const fresh = (name) => `${container}${name}`;

    await checks.check("createContainerAt", async () => {
        const made = await solid.createContainerAt(container);
        assert.equal(solid.getSourceUrl(made), container);
    });
    await checks.check("saveSolidDatasetAt of a new dataset", async () => {
        await solid.saveSolidDatasetAt(fresh("new"), saying(solid.createSolidDataset(), fresh("new"), "one"));
        assert.deepEqual(values(await solid.getSolidDataset(fresh("new")), fresh("new")), ["one"]);
    });
    await checks.check("saveSolidDatasetAt of a changed dataset", async () => {
        const target = fresh("changed");
        await solid.saveSolidDatasetAt(target, saying(solid.createSolidDataset(), target, "one"));
        const read = await solid.getSolidDataset(target);
        await solid.saveSolidDatasetAt(target, saying(read, target, "two"));
        assert.deepEqual(values(await solid.getSolidDataset(target), target), ["one", "two"]);
    });
    await checks.check("saveSolidDatasetInContainer", async () => {
        const saved = await solid.saveSolidDatasetInContainer(container, saying(solid.createSolidDataset(), "urn:thing", "in"), { slugSuggestion: "in" });
        assert.ok(solid.getSourceUrl(saved).startsWith(container));
        assert.deepEqual(values(await solid.getSolidDataset(solid.getSourceUrl(saved)), "urn:thing"), ["in"]);
    });
    await checks.check("saveSolidDatasetAt below containers that do not exist", async () => {
        const target = fresh("a/b/c");
        await solid.saveSolidDatasetAt(target, saying(solid.createSolidDataset(), target, "deep"));
        assert.deepEqual(solid.getContainedResourceUrlAll(await solid.getSolidDataset(fresh("a/"))), [fresh("a/b/")]);
    });
    await checks.check("createContainerInContainer", async () => {
        const made = await solid.createContainerInContainer(container, { slugSuggestion: "inner" });
        assert.ok(solid.isContainer(made));
        assert.ok(solid.getSourceUrl(made).startsWith(container));
    });
    await checks.check("getContainedResourceUrlAll", async () => {
        const listed = solid.getContainedResourceUrlAll(await solid.getSolidDataset(container));
        assert.ok(listed.includes(fresh("new")), String(listed));
    });
    await checks.check("overwriteFile and getFile", async () => {
        for (const text of ["first", "second ä"]) {
            await solid.overwriteFile(fresh("note.txt"), new Blob([text], { type: "text/plain" }), { contentType: "text/plain" });
            const file = await solid.getFile(fresh("note.txt"));
            assert.equal(await file.text(), text);
        }
    });
    await checks.check("saveFileInContainer", async () => {
        const blob = new Blob([new Uint8Array([0, 255, 7])], { type: "application/octet-stream" });
        const saved = await solid.saveFileInContainer(container, blob, { slug: "bytes.bin", contentType: "application/octet-stream" });
        const file = await solid.getFile(solid.getSourceUrl(saved));
        assert.deepEqual([...new Uint8Array(await file.arrayBuffer())], [0, 255, 7]);
    });
    await checks.check("getResourceInfo", async () => {
        const info = await solid.getResourceInfo(fresh("note.txt"));
        assert.ok(solid.isRawData(info));
        assert.equal(solid.getContentType(info).split(";")[0], "text/plain");
        assert.ok(!solid.isRawData(await solid.getResourceInfo(fresh("new"))));
    });
    await checks.check("deleteFile", async () => {
        await solid.deleteFile(fresh("note.txt"));
        await fails("4", () => solid.getFile(fresh("note.txt")));
    });
    await checks.check("deleteSolidDataset", async () => {
        await solid.deleteSolidDataset(fresh("new"));
        await fails("4", () => solid.getSolidDataset(fresh("new")));
    });
    await checks.check("deleteSolidDataset, then saveSolidDatasetAt", async () => {
        const target = fresh("again");
        await solid.saveSolidDatasetAt(target, saying(solid.createSolidDataset(), target, "one"));
        await solid.deleteSolidDataset(target);
        await solid.saveSolidDatasetAt(target, saying(solid.createSolidDataset(), target, "two"));
        assert.deepEqual(values(await solid.getSolidDataset(target), target), ["two"]);
    });
    await checks.check("deleteContainer", async () => {
        const made = await solid.createContainerAt(fresh("empty/"));
        await solid.deleteContainer(made);
        await fails("4", () => solid.getSolidDataset(fresh("empty/")));
    });
    await checks.check("getWellKnownSolid", async () => {
        const found = await solid.getWellKnownSolid(container);
        assert.ok(solid.getThingAll(found, { acceptBlankNodes: true }).length > 0, "nothing");
    });
    await checks.check("a topic is read as a dataset, a resource of the robot written", async () => {
        const topic = `${url}topics/aircraft/engine/speed`;
        const read = await solid.getSolidDataset(topic);
        assert.equal(solid.getStringNoLocale(solid.getThing(read, topic), "https://w3id.org/rosld#name"), "/aircraft/engine/speed");
        const night = `${url}resources/cockpit/night`;
        const value = "http://www.w3.org/1999/02/22-rdf-syntax-ns#value";
        for (const wanted of [true, false]) {
            const before = await solid.getSolidDataset(night);
            await solid.saveSolidDatasetAt(night, solid.setThing(before, solid.setBoolean(solid.getThing(before, night), value, wanted)));
            assert.equal(solid.getBoolean(solid.getThing(await solid.getSolidDataset(night), night), value), wanted);
        }
    });
}
