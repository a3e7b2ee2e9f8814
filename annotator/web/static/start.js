// Before trame's own script: where its web socket is. Else it would ask the server by a request
// that fails, and would believe an address that stands in the link by which the page was opened.
const socket = new URL("ws", document.baseURI);
socket.protocol = socket.protocol.replace("http", "ws");
const secret = document.querySelector("meta[name=secret]").content;
const query = new URLSearchParams({ sessionURL: socket.href, secret: secret });
history.replaceState({}, "", `${location.pathname}?${query}`);
