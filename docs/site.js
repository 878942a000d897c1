// The search leaves out small words of a question: the theme takes them for the beginnings of others.
const SMALL = new Set("a an and are as at be by can do does for from how i in is it my no not of on or the to what when where which why with".split(" "));
const ASKED = 2; // the theme's message of what is looked for
const asked = (message) => {
  if (message?.type !== ASKED || typeof message.data !== "string") return message;
  const words = message.data.split(/\s+/).filter((word) => !SMALL.has(word.toLowerCase()));
  return words.some(Boolean) ? { ...message, data: words.join(" ") } : message;
};

// The search in pages that are opened as files, which may start no workers: it runs in a hidden frame instead.
// The theme loads its index from search_index.js then, which mkdocs_hooks.py writes.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      const inside = frame.contentWindow;
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.loaded = new Promise((loaded) => {
        const script = inside.document.createElement("script");
        script.src = url;
        script.onload = () => loaded(inside);
        inside.document.body.append(script);
      });
    }
    postMessage(data) {
      this.loaded.then((inside) => inside.dispatchEvent(new MessageEvent("message", { data: asked(data) })));
    }
    terminate() {}
  };
} else {
  window.Worker = class extends Worker {
    postMessage(data, ...more) {
      super.postMessage(asked(data), ...more);
    }
  };
}
