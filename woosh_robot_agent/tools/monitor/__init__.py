"""The program `monitor`: shows the state of one robot on a terminal."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.monitor.program")
