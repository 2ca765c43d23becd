"""Bags with messages of many kinds, as tests write them."""

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

NEW, OLD = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)


def filled(types, kind, content):
    """Return a message of a kind; fields that `content` lacks are zero or empty."""
    values = {}
    for name, (what, detail) in types.fielddefs[kind][1]:
        value = content.get(name, {})
        if what.name == "NAME":
            values[name] = filled(types, detail, value)
        elif name in content:
            values[name] = value
        elif what.name == "ARRAY":
            values[name] = np.zeros(detail[1])
        elif what.name == "SEQUENCE":
            values[name] = np.zeros(0)
        else:
            values[name] = "" if detail[0] == "string" else 0
    return types.types[kind](**values)


def header(stamp):
    """Return the content of a header [ns]."""
    return {"stamp": {"sec": int(stamp // 10**9), "nanosec": int(stamp % 10**9)}}


def axes(values, names="xyz"):
    """Return the content of a vector or a quaternion."""
    return dict(zip(names, map(float, values), strict=True))


def write_mcap(path, topics, types=NEW):
    """Write topics, each a kind and messages (log time in ns, content)."""
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, (kind, messages) in topics.items():
            to = bag.add_connection(topic, kind, typestore=types)
            for at, content in messages:
                raw = types.serialize_cdr(filled(types, kind, content), kind)
                bag.write(to, int(at), raw)
    return path


def write_ros1(path, topics, types=OLD):
    """Write topics of ROS 1."""
    with rosbag1.Writer(path) as bag:
        for topic, (kind, messages) in topics.items():
            to = bag.add_connection(topic, kind, typestore=types)
            for at, content in messages:
                raw = types.serialize_ros1(filled(types, kind, content), kind)
                bag.write(to, int(at), raw)
    return path
