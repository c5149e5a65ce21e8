// The Thing Description Playground judges all Thing Descriptions of a robot: node playground.mjs ENTRY [TOKEN]
import playground from "@thing-description-playground/core";

const [entry, token] = process.argv.slice(2);
const headers = { Accept: "application/td+json", ...(token && { Authorization: `Bearer ${token}` }) };
const waiting = [new URL("/.well-known/wot", entry).href];
const seen = new Set();
while (waiting.length > 0) {
    const url = waiting.pop();
    if (seen.has(url)) continue;
    seen.add(url);
    const text = await (await fetch(url, { headers })).text();
    const { report, details } = await playground.tdValidator(text, () => {}, { checkDefaults: false, checkJsonLd: false });
    const failed = Object.keys(details).filter((name) => details[name] === "failed");
    console.log(JSON.stringify({ url, json: report.json, schema: report.schema, failed }));
    waiting.push(...JSON.parse(text).links.filter((link) => link.rel === "item").map((link) => link.href));
}
process.exit(0);
