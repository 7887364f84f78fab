"""Reads a recording with the packages of PyPI and prints what is in it as JSON.

    python bench/peers/mcap/read.py run.mcap

Messages are found through the index of the file and decoded with the schemas that
stand in it. crates/realnet-io/tests/recording_peer.rs compares the numbers.
"""

import json
import struct
import sys
import zlib

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def depths(image):
    """The values of a 32FC1 picture."""
    assert image.encoding == "32FC1" and image.step == 4 * image.width
    return list(struct.unpack(f"<{image.width * image.height}f", image.data))


def described(schema, message, decoded):
    """What of a message is compared."""
    if message_encoding(schema) == "json":
        return decoded
    stamp = decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
    if schema.name == "foxglove.CompressedImage":
        crc, size = zlib.crc32(decoded.data), len(decoded.data)
        return {"stamp": stamp, "format": decoded.format, "crc": crc, "size": size,
                "frame_id": decoded.frame_id}
    if schema.name == "foxglove.RawImage":
        return {"stamp": stamp, "width": decoded.width, "height": decoded.height,
                "depths": depths(decoded)}
    if schema.name == "foxglove.CameraCalibration":
        return {"stamp": stamp, "frame_id": decoded.frame_id, "width": decoded.width,
                "height": decoded.height, "model": decoded.distortion_model,
                "d": list(decoded.D), "k": list(decoded.K), "r": list(decoded.R),
                "p": list(decoded.P)}
    if schema.name == "foxglove.ImageAnnotations":
        return {"stamp": stamp, "texts": [text.text for text in decoded.texts],
                "points": [[[p.x, p.y] for p in points.points] for points in decoded.points]}
    raise SystemExit(f"unexpected schema {schema.name}")


def message_encoding(schema):
    return "json" if schema.encoding == "jsonschema" else schema.encoding


def messages(reader):
    protobuf = DecoderFactory()
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        assert channel.message_encoding == message_encoding(schema)
        if channel.message_encoding == "json":
            decoded = json.loads(message.data)
        else:
            decoded = protobuf.decoder_for(channel.message_encoding, schema)(message.data)
        yield {"topic": channel.topic, "schema": schema.name, "sequence": message.sequence,
               "log_time": message.log_time, "publish_time": message.publish_time,
               "content": described(schema, message, decoded)}


def main():
    with open(sys.argv[1], "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        json.dump({
            "message_count": reader.get_summary().statistics.message_count,
            "messages": list(messages(reader)),
            "attachments": {a.name: a.data.decode() for a in reader.iter_attachments()},
            "metadata": {m.name: m.metadata for m in reader.iter_metadata()},
        }, sys.stdout)


if __name__ == "__main__":
    main()
