"""What a page holds packed, as its script reads it."""

import base64
import gzip
import json


def unpacked(text):
    return gzip.decompress(base64.b64decode(text))


def read_json(text):
    return json.loads(unpacked(text))
