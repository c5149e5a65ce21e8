// The clients in JavaScript, one after the other in one process: node main.mjs URL, the entry URL of a rosld server.
import * as comunica from "./comunica.mjs";
import * as jsonld from "./jsonld.mjs";
import * as rdflib from "./rdflib.mjs";
import * as solid from "./solid-client.mjs";
import { Checks } from "./checks.mjs";

const [url] = process.argv.slice(2);
await jsonld.run(url, new Checks("jsonld"));
await solid.run(url, new Checks("solid-client"));
await rdflib.run(url, new Checks("rdflib"));
await comunica.run(url, new Checks("comunica"));
process.exit(0);
