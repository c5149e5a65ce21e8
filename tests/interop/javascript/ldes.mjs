// ldes-client, the LDES client of Ghent University: node ldes.mjs URL ORDER [PREFER] prints each member as a line of
// JSON, then the pages that it read; PREFER is a preference that its requests have.
import { intoConfig, replicateLDES } from "ldes-client";

const [url, order, prefer] = process.argv.slice(2);
const pages = [];
const read = async (input, init) => {
    const request = new Request(input, init);
    if (prefer) request.headers.set("Prefer", prefer);
    const answer = await fetch(request);
    if (answer.ok) pages.push(answer.url);
    return answer;
};
const client = replicateLDES(intoConfig({ url, fetch: read }), order);
const reader = client.stream().getReader();
const term = ({ termType, value, datatype, language }) =>
    termType === "NamedNode" ? `<${value}>` : termType === "Literal" ? JSON.stringify([value, datatype.value, language]) : "_:b";
const members = [];
for (let found = await reader.read(); !found.done; found = await reader.read()) {
    const { id, quads, timestamp, isVersionOf } = found.value;
    const said = quads.map((quad) => [term(quad.subject), term(quad.predicate), term(quad.object)].join(" ")).sort();
    members.push(`${JSON.stringify({ id: id.value, said, timestamp, isVersionOf })}\n`);
}
process.stdout.write(`${members.join("")}${JSON.stringify({ pages })}\n`, () => process.exit(0));
