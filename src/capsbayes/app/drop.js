// What is dropped on the page goes to the field that it is dropped on, or to that of its step; several files or a folder
// go to the field that takes several, and what is dropped elsewhere to the first or to that one.
document.documentElement.lang = "en";

const within = async (entry) => {
  if (entry.isFile) return [await new Promise((found, failed) => entry.file(found, failed))];
  const reader = entry.createReader(), all = [];
  for (;;) { // a reader hands out a hundred at a time
    const some = await new Promise((found, failed) => reader.readEntries(found, failed));
    if (!some.length) return all;
    for (const one of some) if (!one.name.startsWith(".")) all.push(...(await within(one)));
  }
};

const kinds = (field) => field.querySelector("input").accept.split(",");

const over = (event) => {
  if (!event.dataTransfer.types.includes("Files")) return;
  event.preventDefault();
  event.stopPropagation();
  document.body.classList.toggle("bench-dragged", event.type === "dragover" || event.relatedTarget !== null);
};

const dropped = async (event) => {
  if (!event.dataTransfer.types.includes("Files")) return;
  over(event);
  document.body.classList.remove("bench-dragged");
  const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  const fields = [...document.querySelectorAll(".bench-upload")];
  const many = fields.find((field) => field.querySelector("input").multiple);
  const own = event.target.closest(".bench-upload") || event.target.closest(".bench-step")?.querySelector(".bench-upload");
  const files = (await Promise.all(entries.map(within))).flat();
  const takes = (field) => kinds(field).some((end) => files[0]?.name.toLowerCase().endsWith(end));
  const one = [own, ...fields].find((field) => field && takes(field)) || own || fields[0];
  const field = files.length > 1 || entries[0]?.isDirectory ? many : one;
  const taken = (file) => !entries.some((one) => one.isDirectory) || kinds(field).some((end) => file.name.toLowerCase().endsWith(end));
  getElement(Number(field.id.slice(1))).$refs.qRef.addFiles(files.filter(taken));
};

for (const kind of ["dragover", "dragleave"]) window.addEventListener(kind, over, true);
window.addEventListener("drop", dropped, true);
