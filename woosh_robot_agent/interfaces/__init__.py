"""The interface files of the packages `woosh_*_msgs`, generated from proto/ and the endpoints.

The ROS messages mirror the protobuf messages:

- The packages are those in `names.PACKAGES`; messages of others have a name in `names.OTHERS`.
  The message of a nested message `A.B` is `AB`.
- An enum is a message with its values as `int32` constants and one field `int32 value`. The
  constant of `kRosSuccess` is `K_ROS_SUCCESS`.
- Fields have the same names and order. `bytes` is `uint8[]`, google.protobuf.Any is
  `woosh_common_msgs/AnyProto`.
- The oneof `x` of a message `M` is a field `x` after the other fields. Its type `MOneOfX` has a
  field and a constant for each member, and `which`, which holds the constant of the member that is
  set. `x_choice` repeats it for old clients.
- If a message has fields of message types that are neither repeated nor members of a oneof, it ends
  with the bit mask `has_field`, of the smallest type that has a bit for each protobuf field. Bit i
  is the presence of the i-th protobuf field. By default, all bits are set.

Services and actions have one shape for each kind of endpoint:

- The request of a query is empty, or has the message of the request as `arg`. The response has the
  message of the answer as its only field.
- The request of a command has the message of the request as `arg`. The response has `ok` and `msg`,
  and before them `ret` if the answer has content.
- The goal of an action has `arg`, its result `ret`, and its feedback `fb`.

Comments come from the .proto files, the single source of what a field means. So the files need no
changes by hand: edit proto/ or `endpoints.py`, and run `python3 -m woosh_robot_agent.generate`.
"""

from woosh_robot_agent.interfaces.errors import InterfaceError
from woosh_robot_agent.interfaces.files import interface_files, superfluous_files

__all__ = ["InterfaceError", "interface_files", "superfluous_files"]
