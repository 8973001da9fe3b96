// Pages that are opened from disk may not start a Web Worker, and the search of the site runs in one.
// There, a hidden frame takes the worker's place: it runs the same script, and passes messages both ways.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.answer = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.started = new Promise((resolve) => frame.addEventListener("load", () => resolve(frame.contentWindow)));
      const script = Object.assign(document.createElement("script"), { src: url }).outerHTML;
      frame.srcdoc = `<script>window.postMessage = (data) => frameElement.answer(data);</script>${script}`;
      const attach = () => document.body.append(frame);
      if (document.body) attach();
      else document.addEventListener("DOMContentLoaded", attach);
    }

    async postMessage(data) {
      const scope = await this.started;
      scope.dispatchEvent(new scope.MessageEvent("message", { data }));
    }
  };
}
