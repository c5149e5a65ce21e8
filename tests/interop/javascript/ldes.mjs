// ldes-client, the LDES client of Ghent University: node ldes.mjs URL ORDER prints each member as a line of JSON.
import { intoConfig, replicateLDES } from "ldes-client";

const [url, order] = process.argv.slice(2);
const client = replicateLDES(intoConfig({ url }), order);
const reader = client.stream().getReader();
const term = ({ termType, value, datatype, language }) =>
    termType === "NamedNode" ? `<${value}>` : termType === "Literal" ? JSON.stringify([value, datatype.value, language]) : "_:b";
const members = [];
for (let found = await reader.read(); !found.done; found = await reader.read()) {
    const { id, quads, timestamp, isVersionOf } = found.value;
    const said = quads.map((quad) => [term(quad.subject), term(quad.predicate), term(quad.object)].join(" ")).sort();
    members.push(`${JSON.stringify({ id: id.value, said, timestamp, isVersionOf })}\n`);
}
process.stdout.write(members.join(""), () => process.exit(0));
