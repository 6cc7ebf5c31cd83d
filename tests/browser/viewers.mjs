// Reads MCAP files by Foxglove's own packages, and prints as JSON what is in each channel: node viewers.mjs FILE...
//
// For each channel: encoding, schema, how many messages decode, the keys of the last, and fields of Foxglove's schema
// that the last message lacks.

import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";
import { foxgloveMessageSchemas } from "@foxglove/schemas/internal.js";

const known = new Map(Object.values(foxgloveMessageSchemas).map((schema) => [`foxglove.${schema.name}`, schema]));
const decompressHandlers = await loadDecompressHandlers();

/** Return what decodes the messages of a channel by the schema that the file has. */
function decoderOf(encoding, schema) {
  if (encoding === "json") return (data) => JSON.parse(new TextDecoder().decode(data));
  const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
  return (data) => type.decode(data);
}

async function channelsOf(path) {
  const file = await open(path);
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
  const found = {};
  const parsed = new Map();
  for await (const { channelId, data } of reader.readMessages()) {
    const channel = reader.channelsById.get(channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!parsed.has(channelId)) parsed.set(channelId, decoderOf(channel.messageEncoding, schema));
    const message = parsed.get(channelId)(data);
    const fields = known.get(schema.name)?.fields.map(({ name }) => name) ?? [];
    const row = (found[channel.topic] ??= { encoding: channel.messageEncoding, schema: schema.name, messages: 0 });
    row.messages += 1;
    row.keys = Object.keys(message);
    row.missing = channel.messageEncoding === "protobuf" ? fields.filter((name) => !(name in message)) : [];
    row.known = known.has(schema.name);
    row.last = JSON.stringify(message, (_, value) => (typeof value === "bigint" ? Number(value) : value)).slice(0, 400);
  }
  await file.close();
  return found;
}

const [, , ...files] = process.argv;
const found = {};
for (const path of files) found[path] = await channelsOf(path);
console.log(JSON.stringify(found));
