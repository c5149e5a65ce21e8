// Runs the checks of one client in turn and prints the outcome of each as a line of JSON.

const LIMIT_MS = 20_000;

let fail = () => {};
process.on("unhandledRejection", (error) => fail(error)); // of a promise that the client let go

export class Checks {
    constructor(client) {
        this.client = client;
    }

    /** Something a client does; it fails by throwing. */
    async check(name, body) {
        let timer;
        const late = new Promise((_, refuse) => {
            fail = refuse;
            timer = setTimeout(() => refuse(new Error(`no end within ${LIMIT_MS} ms`)), LIMIT_MS);
        });
        let error = null;
        try {
            await Promise.race([body(), late]);
        } catch (thrown) {
            error = String(thrown?.stack ?? thrown).slice(0, 2000);
        } finally {
            clearTimeout(timer);
        }
        console.log(JSON.stringify({ client: this.client, check: name, error }));
    }
}

/** Fails where the body does not fail with an error whose text has this part. */
export async function fails(part, body) {
    try {
        await body();
    } catch (error) {
        if (String(error).includes(part)) return;
        throw new Error(`expected '${part}' in ${error}`);
    }
    throw new Error(`expected an error with '${part}'`);
}

/** The resource as it is read: the status, its N-Triples. */
export async function read(url) {
    const answer = await fetch(url, { headers: { Accept: "application/n-triples" } });
    return { status: answer.status, text: await answer.text() };
}

export async function put(url, body, type = "text/turtle") {
    const answer = await fetch(url, { method: "PUT", body, headers: { "Content-Type": type } });
    if (!answer.ok) throw new Error(`${answer.status}: ${await answer.text()}`);
}

/** Pages of all kinds. */
export const PAGES = [
    "", "topics/", "topics/aircraft/engine/speed", "nodes/", "services/aircraft/start", "parameters/", "parameters/cockpit/night",
    "resources/", "resources/aircraft/", "resources/aircraft/power", "mappings/", "data/", "queries/", "queries/inventory", "sparql",
    "ontology", "shapes/limits", "shapes/mapping", "shapes/std_msgs/msg/String", "types/std_msgs/msg/String", "calls/", "bags/",
    ".well-known/solid",
];
