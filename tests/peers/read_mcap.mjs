// Reads an MCAP file with the container's reference implementation and its messages with the
// schemas the file itself carries; prints what it found as JSON.
//   node read_mcap.mjs FILE [--stream]   --stream: front to back, as for a file cut short
import { readFile, open } from 'node:fs/promises';
import { McapIndexedReader, McapStreamReader } from '@mcap/core';
import protobuf from 'protobufjs';
import descriptor from 'protobufjs/ext/descriptor/index.js';

const [file, mode] = process.argv.slice(2);
const found = { schemas: {}, channels: {}, metadata: {}, messages: [], chunks: 0 };
const types = new Map();

function addSchema(schema) {
  found.schemas[schema.id] = schema.name;
  const set = descriptor.FileDescriptorSet.decode(schema.data);
  types.set(schema.id, protobuf.Root.fromDescriptor(set).lookupType(schema.name));
}

function addMessage(message, channel) {
  const decoded = types.get(channel.schemaId).decode(message.data);
  const { seconds, nanos } = decoded.timestamp;
  const stampNs = BigInt(seconds.toString()) * 1000000000n + BigInt(nanos);
  const out = { topic: channel.topic, sequence: message.sequence,
                logTime: message.logTime.toString(), stamp: stampNs.toString() };
  if (decoded.format !== undefined) {
    out.format = decoded.format;
    out.bytes = decoded.data.length;
    out.begins = Buffer.from(decoded.data.subarray(0, 3)).toString('hex');
  }
  if (decoded.K !== undefined) Object.assign(out, { width: decoded.width, height: decoded.height,
                                                    K: decoded.K, P: decoded.P });
  found.messages.push(out);
}

async function readIndexed() {
  const handle = await open(file);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      const { bytesRead } = await handle.read(buffer, 0, buffer.length, Number(offset));
      if (bytesRead !== buffer.length) throw new Error('short read');
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable });
  found.chunks = reader.chunkIndexes.length;
  found.statistics = { messages: reader.statistics.messageCount.toString() };
  reader.schemasById.forEach(addSchema);
  reader.channelsById.forEach((channel) => { found.channels[channel.id] = channel.topic; });
  for await (const item of reader.readMetadata()) {
    found.metadata[item.name] = Object.fromEntries(item.metadata);
  }
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    addMessage(message, reader.channelsById.get(message.channelId));
  }
  await handle.close();
}

async function readStream() {
  const reader = new McapStreamReader({ validateCrcs: true });
  reader.append(new Uint8Array(await readFile(file)));
  const channels = new Map();
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === 'Schema') addSchema(record);
    if (record.type === 'Channel') channels.set(record.id, record);
    if (record.type === 'Message') addMessage(record, channels.get(record.channelId));
  }
}

await (mode === '--stream' ? readStream() : readIndexed());
console.log(JSON.stringify(found));
