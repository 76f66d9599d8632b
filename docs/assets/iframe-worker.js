// Pages of the file system may not start workers. There the search runs in a hidden frame that behaves like one.
if (location.protocol === "file:") {
  const started = []
  window.searchFrame = frame => started.find(worker => worker.frame.contentWindow === frame)
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.waiting = []
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      this.frame.srcdoc = `<script>
        const worker = parent.searchFrame(window)
        window.importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done, failed) => {
          const script = Object.assign(document.createElement("script"), { src: url, onload: done, onerror: failed })
          document.head.append(script)
        })), Promise.resolve())
        window.postMessage = data => worker.dispatchEvent(new parent.MessageEvent("message", { data }))
        importScripts(${JSON.stringify(String(url))}).then(() => worker.ready())
      <\/script>`
      started.push(this)
      document.documentElement.append(this.frame)
    }
    ready() {
      const waiting = this.waiting
      this.waiting = null
      waiting.forEach(data => this.postMessage(data))
    }
    postMessage(data) {
      if (this.waiting) this.waiting.push(data)
      else this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }))
    }
    terminate() {
      this.frame.remove()
    }
  }
}
