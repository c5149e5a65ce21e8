// A Web of Things client flies the aircraft: node wot.mjs ENTRY CRUISE
//
// node-wot consumes the Thing Descriptions that the server writes. The properties and actions are found by the terms
// that they are annotated with, not by their names. What happens is printed, a line of JSON each.
import binding from "@node-wot/binding-http";
import core from "@node-wot/core";

const AV = "https://w3id.org/rosld/aircraft#";
const PAUSE_MS = 100;
const PATIENCE_MS = 30_000;

const tell = (line) => console.log(JSON.stringify(line));

/** The name of the affordance that is annotated with a term. */
function named(affordances, annotation, term) {
    const found = Object.entries(affordances).find(([, one]) => one[annotation]?.["@id"] === AV + term);
    return found?.[0];
}

/** The Thing Description of a resource. (WoT.requestThingDescription asks for no media type, and so gets the state.) */
async function description(url) {
    const answer = await fetch(url, { headers: { Accept: "application/td+json" } });
    return answer.ok ? answer.json() : undefined;
}

/** Wait until something is so. */
async function until(isSo, what) {
    const end = Date.now() + PATIENCE_MS;
    while (!(await isSo())) {
        if (Date.now() > end) throw new Error(`never came: ${what}`);
        await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
}

/** Try what is refused, and tell the error. */
async function refused(what, attempt) {
    try {
        await attempt();
        tell({ accepted: what });
    } catch (error) {
        tell({ refused: what, error: error.message });
    }
}

const [entry, cruise] = [process.argv[2], Number(process.argv[3])];
const servient = new core.Servient();
servient.addClientFactory(new binding.HttpClientFactory());
const wot = await servient.start();

// RFC 8615 and WoT Discovery 6.3 name the one place to begin at; links lead on.
const robot = await wot.requestThingDescription(new URL("/.well-known/wot", entry).href);

/** The thing, of those that are there now, that has an affordance annotated with a term; and that affordance's name. */
async function thingWith(affordances, annotation, term) {
    for (const { href } of robot.links.filter((link) => link.rel === "item")) {
        const found = await description(href);
        const name = found && named(found[affordances] ?? {}, annotation, term);
        if (name !== undefined) return { thing: await wot.consume(found), description: found, name };
    }
    throw new Error(`nothing has ${AV}${term}`);
}

const read = async (thing, name) => (await thing.readProperty(name)).value();

const { thing: aircraft, description: about, name: start } = await thingWith("actions", "map:relation", "start");
const stop = named(about.actions, "map:relation", "stop");
const power = named(about.properties, "map:predicate", "power");
tell({ power: await read(aircraft, power) });
await refused("stop", () => aircraft.invokeAction(stop));
tell({ started: await (await aircraft.invokeAction(start)).value() });
await refused("start", () => aircraft.invokeAction(start));

const { thing: engine, description: inside, name: speed } = await thingWith("properties", "map:predicate", "speed");
const { minimum, maximum } = inside.properties[speed];
tell({ things: [about.title, inside.title], bounds: [minimum, maximum] });
await refused("too fast", () => engine.writeProperty(speed, maximum + 1));

const observed = [];
const observing = await engine.observeProperty(speed, async (output) => observed.push(await output.value()));
for (const wanted of [cruise, 0]) {
    await engine.writeProperty(speed, wanted);
    await until(async () => (await read(engine, speed)) === wanted, `speed ${wanted}`);
    await until(() => observed.at(-1) === wanted, `speed ${wanted} observed`);
    tell({ speed: wanted });
}
await observing.stop();
tell({ observed });

const heard = [];
const hearing = await aircraft.subscribeEvent("changed", async (output) => heard.push((await output.value()).power));
await until(() => heard.length > 0, "the present state");
tell({ stopped: await (await aircraft.invokeAction(stop)).value() });
await until(() => heard.at(-1) === "off", "the change");
await hearing.stop();
tell({ heard });
tell({ power: await read(aircraft, power) });
await servient.shutdown();
