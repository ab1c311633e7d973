// Transfers files between this page and the console in parts, by calls over the socket.

const PART = 36000 - 36000 % 3; // bytes of a part, whose base64 has the console's limit
const MOST = 64 << 20; // bytes in total, the console's limit

/** Upload files; resolves to the console's key for them. `onProgress(share)` reports progress. */
export async function upload(socket, files, onProgress) {
  const all = files.reduce((sum, file) => sum + file.size, 0);
  if (all > MOST) throw new Error(`the files have ${Math.ceil(all / 1e6)} MB; the limit is ${MOST >> 20} MB`);
  const key = await socket.call("upload");
  let sent = 0;
  for (const file of files) {
    const bytes = new Uint8Array(await file.arrayBuffer());
    for (let at = 0; at === 0 || at < bytes.length; at += PART) {
      const part = bytes.subarray(at, at + PART);
      await socket.call("upload_part", { key, file: file.name, at, data: base64(part) });
      sent += part.length;
      onProgress(sent / all);
    }
  }
  return key;
}

/** Download a file and let the browser save it; `found`: the console's {key, file, size}. */
export async function download(socket, { key, file, size }) {
  const parts = [];
  for (let at = 0; at < size;) {
    const part = Uint8Array.from(atob(await socket.call("download_part", { key, at })), (letter) => letter.charCodeAt(0));
    parts.push(part);
    at += part.length;
  }
  const address = URL.createObjectURL(new Blob(parts, { type: "application/zip" }));
  const link = document.createElement("a");
  Object.assign(link, { href: address, download: file });
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

function base64(bytes) {
  let text = "";
  for (let i = 0; i < bytes.length; i += 4096) text += String.fromCharCode(...bytes.subarray(i, i + 4096));
  return btoa(text);
}
