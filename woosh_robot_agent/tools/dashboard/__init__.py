"""The program `dashboard`: a page in the browser that shows robots, and can drive them."""
