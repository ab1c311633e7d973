"""The console: a page in the browser that shows a deployment and drives its robots; see docs/operate/console.md."""
