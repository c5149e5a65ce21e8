// Foxglove's own client of its protocol: what a viewer does, with the results as JSON on standard output.
import { FoxgloveClient } from "@foxglove/ws-protocol";

const { ws, url } = { ws: globalThis.WebSocket, url: process.argv[2] };
const client = new FoxgloveClient({ ws: new ws(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const result = {};
const channels = new Map();
const services = new Map();
const text = (value) => { // a string of ROS 1
  const octets = new TextEncoder().encode(value);
  const data = new Uint8Array(4 + octets.length);
  new DataView(data.buffer).setUint32(0, octets.length, true);
  data.set(octets, 4);
  return data;
};
const readText = ({ buffer, byteOffset }) => {
  const length = new DataView(buffer, byteOffset).getUint32(0, true);
  return new TextDecoder().decode(new Uint8Array(buffer, byteOffset + 4, length));
};
const once = (event, fits) => new Promise((resolve, reject) => {
  setTimeout(() => reject(new Error(`no ${event} in time`)), 20000).unref();
  client.on(event, (value) => { if (fits(value)) resolve(value); });
});

client.on("advertise", (all) => all.forEach((each) => channels.set(each.topic, each)));
client.on("advertiseServices", (all) => all.forEach((each) => services.set(each.name, each)));
client.on("error", (error) => { console.error(error); process.exit(1); });
const info = await once("serverInfo", () => true);
result.name = info.name.length > 0;
while (!channels.has("/aircraft/engine/speed") || !services.has("/aircraft/get_power")) {
  await new Promise((resolve) => setTimeout(resolve, 20));
}
const channel = channels.get("/aircraft/engine/speed");
result.definition = channel.schema.trim();
const subscription = client.subscribe(channel.id);
const message = await once("message", (each) => each.subscriptionId === subscription);
result.speed = message.data.getFloat64(0, true);

const call = (name, callId, data) => client.sendServiceCallRequest({
  serviceId: services.get(name).id, callId, encoding: "ros1", data: new DataView(data.buffer),
});
call("/aircraft/get_power", 1, new Uint8Array(0));
result.power = readText((await once("serviceCallResponse", (each) => each.callId === 1)).data);
const fast = new Uint8Array(8);
new DataView(fast.buffer).setFloat64(0, 5000, true);
call("/aircraft/engine/set_speed", 2, fast);
const failure = await once("serviceCallFailure", (each) => each.callId === 2);
result.failure = failure.message.includes("1000");

client.getParameters(["/aircraft/seats"], "p");
result.parameter = (await once("parameterValues", (each) => each.id === "p")).parameters[0].value;
client.subscribeConnectionGraph();
const graph = await once("connectionGraphUpdate", () => true);
result.publishers = graph.publishedTopics.find((each) => each.name === "/aircraft/engine/speed").publisherIds;

const own = client.advertise({ topic: "/cockpit/display", encoding: "ros1", schemaName: "std_msgs/String" });
const display = client.subscribe(channels.get("/cockpit/display").id);
client.sendMessage(own, text("from JavaScript"));
const shown = await once("message", (each) => each.subscriptionId === display && readText(each.data).startsWith("from"));
result.published = readText(shown.data);
console.log(JSON.stringify(result));
client.close();
