"""The program `dashboard`: a page in the browser that shows robots, and can drive them."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.dashboard.program")
