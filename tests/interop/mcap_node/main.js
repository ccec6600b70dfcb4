// Counts the messages of whole MCAP files by topic, by their index: `FILE TOPIC COUNT` a line.
import { McapIndexedReader } from "@mcap/core";
import { open } from "node:fs/promises";

class File {
  constructor(handle) {
    this.handle = handle;
  }

  async size() {
    return BigInt((await this.handle.stat()).size);
  }

  async read(offset, size) {
    const bytes = new Uint8Array(Number(size));
    await this.handle.read(bytes, 0, bytes.length, Number(offset));
    return bytes;
  }
}

for (const path of process.argv.slice(2)) {
  const handle = await open(path);
  const reader = await McapIndexedReader.Initialize({ readable: new File(handle) });
  const counts = new Map();
  for await (const message of reader.readMessages()) {
    const { topic } = reader.channelsById.get(message.channelId);
    counts.set(topic, (counts.get(topic) ?? 0) + 1);
  }
  for (const [topic, count] of [...counts].sort()) {
    console.log(`${path} ${topic} ${count}`);
  }
  await handle.close();
}
