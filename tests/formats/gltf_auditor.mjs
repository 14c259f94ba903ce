// Prints what the asset auditor of Khronos finds unfit in glTF files, as JSON: a list of names, in the order of the files.
// Null stands for a file that it does not read.
// Called with the folder in which the package is installed, and the files.
import fs from "fs";
import path from "path";
import { pathToFileURL } from "url";

const [folder, ...files] = process.argv.slice(2);
const place = path.resolve(folder, "node_modules", "@khronosgroup", "gltf-asset-auditor");
const { Auditor } = await import(pathToFileURL(path.join(place, "dist", "Auditor.js")));
const schema = path.join(place, "tests", "schemas", "khronos-recommended.json");
const print = console.log;
console.log = () => {}; // the auditor talks while it works

async function failures(file) {
  const beside = (fs.readdirSync(path.dirname(file), { recursive: true }) ?? [])
    .map((each) => path.join(path.dirname(file), each))
    .filter((each) => !/\.(gltf|glb)$/.test(each) && fs.statSync(each).isFile());
  const auditor = new Auditor();
  await auditor.schema.loadFromFileSystem(schema);
  auditor.schema.requireNotOverlappingUVs.value = false; // slow, and triangles stay what they are
  await auditor.model.loadFromFileSystem(file.endsWith(".glb") ? [file] : [file, ...beside]);
  auditor.generateReport();
  return auditor.report.getItems().filter((item) => item.tested && !item.pass).map((item) => item.name);
}

const all = [];
for (const file of files) {
  all.push(await failures(file).catch(() => null)); // Draco among them, for which it wants a browser
}
print(JSON.stringify(all));
process.exit(0);
