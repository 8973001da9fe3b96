// The visit's number, which the address keeps, and the drawer of the controls on a phone.
(() => {
  const asked = new URLSearchParams(location.search);
  if (!/^[0-9a-f]{32}$/.test(asked.get("visit") || "")) {
    const bytes = crypto.getRandomValues(new Uint8Array(16));
    asked.set("visit", [...bytes].map((one) => one.toString(16).padStart(2, "0")).join(""));
  }
  const replace = history.replaceState.bind(history);
  const write = () => replace(null, "", "?" + asked.toString());
  const scheme = location.protocol === "https:" ? "wss://" : "ws://";
  const [opened] = performance.getEntriesByType("navigation");
  const again = opened && opened.type === "reload" ? "&again=1" : ""; // not set in a second tab
  asked.set("websocket", scheme + location.host + "/?visit=" + asked.get("visit") + again);
  write(); // where viser looks for its server
  asked.delete("websocket");
  asked.delete("token"); // the browser keeps it as a cookie
  history.replaceState = write; // viser writes the address when it has read it, however slow the browser is

  const drawer = '.mantine-Paper-root[style*="position: fixed"]';
  const handle = `${drawer} .mantine-ScrollArea-content > div > div:first-child`;
  const act = (event) => {
    const hit = event.target.closest(handle);
    if (!hit || event.target.closest("button") || !matchMedia("(max-width: 36em)").matches) return;
    event.stopPropagation(); // viser would remove the controls, and with them the card over the view
    if (!document.documentElement.classList.toggle("open-drawer")) {
      hit.closest(".mantine-ScrollArea-viewport").scrollTop = 0;
    }
  };
  document.addEventListener("click", act, true);
})();
