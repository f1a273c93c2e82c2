// Foxglove's own client at a run: node foxglove_client.mjs ADDRESS FOLDER_OF_NODE_MODULES. Prints what it saw as JSON.
import { createRequire } from "node:module";

const [address, folder] = process.argv.slice(2);
const load = createRequire(`${folder}/`);
const { FoxgloveClient } = load("@foxglove/ws-protocol");
const WebSocket = load("ws");
const protocols = ["foxglove.sdk.v1", FoxgloveClient.SUPPORTED_SUBPROTOCOL];
const client = new FoxgloveClient({ ws: new WebSocket(address, protocols) });
const seen = { encodings: {}, counts: {}, parameters: {}, answers: {}, problems: [] };
const topics = new Map();
const services = new Map();
const bytes = (value) => new Uint8Array(Buffer.from(JSON.stringify(value)));
const call = (callId, action, keys) =>
  client.sendServiceCallRequest({
    serviceId: services.get(`/operator/${action}`), callId, encoding: "json", data: bytes(keys),
  });
const end = () => {
  console.log(JSON.stringify(seen));
  process.exit(0);
};
const next = {
  1: () => call(2, "wind", { mean_mps: 999 }),
  2: () => call(3, "resume", {}),
  3: () => client.setParameters([{ name: "environment.wind.mean_mps", value: 6.5 }], "set"),
  4: end,
};

client.on("error", (error) => {
  seen.problems.push(String(error));
  end();
});
client.on("close", end);
client.on("status", (status) => seen.problems.push(status.message));
client.on("serviceCallFailure", (failure) => seen.problems.push(JSON.stringify(failure)));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    seen.encodings[channel.topic] = `${channel.encoding} ${channel.schemaEncoding}`;
    topics.set(client.subscribe(channel.id), channel.topic);
  }
});
client.on("message", ({ subscriptionId }) => {
  const topic = topics.get(subscriptionId);
  seen.counts[topic] = (seen.counts[topic] ?? 0) + 1;
  if (topic === "/truth/bodies" && seen.counts[topic] === 1) call(4, "pace", {});
});
client.on("advertiseServices", (offered) => {
  for (const { name, id } of offered) services.set(name, id);
  if (!(1 in seen.answers)) call(1, "pause", {});
});
client.on("serviceCallResponse", ({ callId, data }) => {
  seen.answers[callId] = JSON.parse(Buffer.from(data.buffer, data.byteOffset, data.byteLength).toString());
  next[callId]();
});
client.on("parameterValues", ({ parameters, id }) => {
  for (const { name, value } of parameters) seen.parameters[name] = value;
  if (id !== "set") return;
  const channelId = client.advertise({ topic: "/clicked_point", encoding: "json", schemaName: "geometry_msgs/Point" });
  client.sendMessage(channelId, bytes({ point: { x: 20, y: 14, z: 0 } }));
});
