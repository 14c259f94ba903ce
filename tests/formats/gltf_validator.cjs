// Prints the issues that the official validator finds in glTF files, as JSON: a list of lists, in the order of the files.
// Called with the folder of the package gltf-validator and the files.
const fs = require("fs");
const path = require("path");
const validator = require(path.resolve(process.argv[2]));

async function issuesOf(file) {
  const beside = (uri) => fs.promises.readFile(path.join(path.dirname(file), decodeURIComponent(uri)));
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
    maxIssues: 0,
    externalResourceFunction: async (uri) => new Uint8Array(await beside(uri)),
  });
  return report.issues.messages;
}

Promise.all(process.argv.slice(3).map(issuesOf)).then((found) => console.log(JSON.stringify(found)));
