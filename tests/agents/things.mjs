// A Web of Things client with a token reads all properties of a robot, and sets one: node things.mjs ENTRY TOKEN
import binding from "@node-wot/binding-http";
import core from "@node-wot/core";

const [entry, token] = process.argv.slice(2);
const tell = (line) => console.log(JSON.stringify(line));
const servient = new core.Servient();
servient.addClientFactory(new binding.HttpClientFactory());

const wot = await servient.start();
const headers = { Accept: "application/td+json", Authorization: `Bearer ${token}` };
const description = await (await fetch(new URL("/.well-known/wot", entry), { headers })).json();
servient.addCredentials({ [description.id]: { token } });
const robot = await wot.consume(description);
await robot.invokeAction("aircraft/start");
const values = {};
for (const name of Object.keys(description.properties)) values[name] = await (await robot.readProperty(name)).value();
tell({ security: description.security, values });
await robot.writeProperty("cockpit/brightness", 0.5);
await servient.shutdown();
process.exit(0);
