"""The program `replay`: serves a recording as a chassis would."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.replay.program")
