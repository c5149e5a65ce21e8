// A Web of Things client reads all properties of a robot, and hears of a change: node things.mjs ENTRY [TOKEN]
import binding from "@node-wot/binding-http";
import core from "@node-wot/core";

const [entry, token] = process.argv.slice(2);
const tell = (line) => console.log(JSON.stringify(line));
const servient = new core.Servient();
servient.addClientFactory(new binding.HttpClientFactory());

/** The Thing Description at a URL, consumed with the token as a client's credentials, if there is one. */
async function thing(wot, url) {
    const headers = { Accept: "application/td+json", ...(token && { Authorization: `Bearer ${token}` }) };
    const description = await (await fetch(url, { headers })).json();
    if (token) servient.addCredentials({ [description.id]: { token } });
    return { consumed: await wot.consume(description), description };
}

const wot = await servient.start();
const robot = await thing(wot, new URL("/.well-known/wot", entry));
await robot.consumed.invokeAction("aircraft/start");
const values = {};
for (const name of Object.keys(robot.description.properties)) {
    values[name] = await (await robot.consumed.readProperty(name)).value();
}
tell({ security: robot.description.security, values });
await robot.consumed.writeProperty("cockpit/brightness", 0.5);
if (!token) { // node-wot sends no credentials with event streams
    const aircraft = await thing(wot, new URL("/resources/aircraft/", entry));
    const heard = [];
    await new Promise((resolve) => {
        aircraft.consumed.subscribeEvent("changed", async (output) => {
            heard.push((await output.value()).power);
            if (heard.length === 1) await aircraft.consumed.invokeAction("stop"); // the first is of the present
            if (heard.at(-1) === "off") resolve();
        });
    });
    tell({ heard });
}
await servient.shutdown();
process.exit(0);
