"""The program `record`: writes all frames between a robot and its clients into a file."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.record.program")
