// decode FILE: a JSON object a message, by node-mavlink. request TS1: a TIMESYNC request.

const fs = require('node:fs')
const { MavLinkProtocolV2, createMavLinkStream, common, minimal } = require('node-mavlink')

const REGISTRY = { ...minimal.REGISTRY, ...common.REGISTRY }

const inSnakeCase = (name) => name.replace(/([A-Z])/g, '_$1').toLowerCase()

// JSON has no 64-bit integers and no NaN
const plain = (value) => {
  if (typeof value === 'bigint') return String(value)
  if (Array.isArray(value)) return value.map(plain)
  return value
}

function decode (path) {
  createMavLinkStream(fs.createReadStream(path)).on('data', (packet) => {
    const kind = REGISTRY[packet.header.msgid]
    const message = packet.protocol.data(packet.payload, kind)
    const line = { name: kind.MSG_NAME, sequence: packet.header.seq }
    line.sender = [packet.header.sysid, packet.header.compid]
    for (const field of kind.FIELDS) line[inSnakeCase(field.name)] = plain(message[field.name])
    console.log(JSON.stringify(line))
  })
}

function request (ts1) {
  const message = new common.TimeSync()
  message.tc1 = 0n
  message.ts1 = BigInt(ts1)
  message.targetSystem = 1
  message.targetComponent = 197
  process.stdout.write(new MavLinkProtocolV2(1, 1).serialize(message, 7))
}

const [, , command, argument] = process.argv
if (command === 'decode') decode(argument)
else request(argument)
