// @asyncapi/parser, the parser of the AsyncAPI Initiative: node asyncapi.mjs URL prints its diagnostics and what it read.
import { Parser } from "@asyncapi/parser";

const text = await (await fetch(process.argv[2])).text();
const { document, diagnostics } = await new Parser().parse(text);
const operations = document?.operations().all() ?? [];
console.log(
    JSON.stringify({
        problems: diagnostics.filter((each) => each.severity <= 1).map((each) => `${each.path.join("/")}: ${each.message}`),
        version: document?.version(),
        servers: document?.servers().all().map((each) => each.protocol()),
        operations: operations.map((each) => [each.action(), each.channels().all()[0].address()]),
    }),
);
