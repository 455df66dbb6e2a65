// node reencode.mjs IN OUT: reads a log with every CRC checked, once as a stream and once through its summary and
// indexes, writes it again with the implementation's own writer, and prints as JSON what it found.

import { open } from "node:fs/promises";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader, McapWriter } from "@mcap/core";

const [source, target] = process.argv.slice(2);
await zstd.isLoaded;
const decompressHandlers = { zstd: (packed, size) => zstd.decompress(packed, Number(size)) };

const output = await open(target, "w");
let position = 0n;
const writer = new McapWriter({
  writable: {
    write: async (bytes) => {
      await output.writeFile(bytes);
      position += BigInt(bytes.byteLength);
    },
    position: () => position,
  },
  compressChunk: (content) => ({ compression: "zstd", compressedData: zstd.compress(content, 3) }),
});
await writer.start({ profile: "", library: "@mcap/core" });

const input = await open(source, "r");
const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers });
const schemas = new Map([[0, 0]]);
const channels = new Map();
const streamed = {};

async function take(record) {
  streamed[record.type] = (streamed[record.type] ?? 0) + 1;
  if (record.type === "Schema" && !schemas.has(record.id)) {
    schemas.set(record.id, await writer.registerSchema(record));
  } else if (record.type === "Channel" && !channels.has(record.id)) {
    channels.set(record.id, await writer.registerChannel({ ...record, schemaId: schemas.get(record.schemaId) }));
  } else if (record.type === "Message") {
    await writer.addMessage({ ...record, channelId: channels.get(record.channelId) });
  } else if (record.type === "Attachment") {
    await writer.addAttachment(record);
  } else if (record.type === "Metadata") {
    await writer.addMetadata(record);
  }
}

const block = Buffer.alloc(1 << 20);
for (;;) {
  const { bytesRead } = await input.read(block, 0, block.length, null);
  if (bytesRead === 0) break;
  reader.append(new Uint8Array(block.subarray(0, bytesRead)));
  for (let record; (record = reader.nextRecord()); ) await take(record);
}
if (!reader.done()) throw new Error(`${source}: the stream reader found no end`);
await writer.end();
await output.close();

const indexed = await McapIndexedReader.Initialize({
  readable: {
    size: async () => BigInt((await input.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      await input.read(bytes, 0, bytes.length, Number(offset));
      return bytes;
    },
  },
  decompressHandlers,
});
let inOrder = 0;
let latest = 0n;
for await (const message of indexed.readMessages()) {
  if (message.logTime < latest) throw new Error(`${source}: message ${inOrder} is not in order of log time`);
  latest = message.logTime;
  inOrder += 1;
}
await input.close();
const statistics = indexed.statistics;
console.log(
  JSON.stringify({
    streamed,
    indexed_messages: inOrder,
    announced_messages: Number(statistics.messageCount),
    chunk_indexes: indexed.chunkIndexes.length,
    schemas: indexed.schemasById.size,
    channels: indexed.channelsById.size,
    attachments: indexed.attachmentIndexes.length,
    metadata: indexed.metadataIndexes.length,
  }),
);
