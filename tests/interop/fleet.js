// A fleet control by Siemens' vda-5050-lib, told what to do by lines of JSON on its standard input.
//
// What happens is written as lines of JSON: every message on the broker as it is ("raw"), with what
// the library's validators of VDA 5050 2.0 find wrong with it, and what the library makes of the
// states ("node", "edge", "action", "processed", "presence").
"use strict";

const path = require("path");
const readline = require("readline");
const [broker, interfaceName] = process.argv.slice(2);
const { MasterController } = require("vda-5050-lib");
const mqtt = require("mqtt");
const library = path.dirname(require.resolve("vda-5050-lib"));
const validators = require(path.join(library, "common", "vda-5050-validators-2.0.js"));

const tell = (event, fields) => process.stdout.write(JSON.stringify({ event, ...fields }) + "\n");
const options = JSON.parse(process.env.FLEET_OPTIONS || "{}");

const handler = {
    onOrderProcessed: (error, cancelled, active, context) =>
        tell("processed", { order: context.order.orderId, error: error || null, cancelled, active }),
    onNodeTraversed: (node, _edge, _end, context) =>
        tell("node", { order: context.order.orderId, node: node.nodeId, sequence: node.sequenceId }),
    onEdgeTraversed: (edge, _start, _end, context) =>
        tell("edge", { order: context.order.orderId, edge: edge.edgeId }),
    onActionStateChanged: (state, error, action) =>
        tell("action", { id: action.actionId, status: state.actionStatus, error: error || null }),
};
const actions = {
    onActionStateChanged: (state, error, action) =>
        tell("action", { id: action.actionId, status: state.actionStatus, error: error || null }),
    onActionError: (error, action) => tell("action", { id: action.actionId, status: "ERROR", error }),
};

// Every message of the topics of version 2, as the schemas see it.
const checks = {
    connection: validators.validateConnection, state: validators.validateState,
    factsheet: validators.validateFactsheet, visualization: validators.validateVisualization,
};
const raw = mqtt.connect(broker, { ...options, reconnectPeriod: 100 });
raw.on("connect", () => raw.subscribe(interfaceName + "/#", { qos: 1 }, () => tell("listening", {})));
raw.on("error", error => tell("trouble", { error: String(error) }));
raw.on("message", (topic, payload, packet) => {
    const [, version, manufacturer, serial, last] = topic.split("/");
    const message = JSON.parse(payload.toString());
    const check = version === "v2" ? checks[last] : undefined;
    const wrong = check && !check(message) ? check.errors : null;
    tell("raw", { version, manufacturer, serial, topic: last, retained: packet.retain, message, wrong });
});

async function main() {
    const controller = new MasterController(
        { interfaceName, transport: { brokerUrl: broker, reconnectPeriod: 100, ...options }, vdaVersion: "2.0.0" },
        {});
    await controller.start();
    controller.trackAgvs((agv, state) => tell("presence", { serial: agv.serialNumber, state }));
    tell("ready", {});
    for await (const line of readline.createInterface({ input: process.stdin })) {
        const { serial, order, instant, send } = JSON.parse(line);
        const agv = { manufacturer: "Omnibus", serialNumber: serial };
        if (order) {
            await controller.assignOrder(agv, order, handler);
        } else if (instant) {
            await controller.initiateInstantActions(agv, { instantActions: instant }, actions);
        } else if (send) {
            raw.publish(send.topic, JSON.stringify(send.message), { qos: send.qos || 0, retain: send.retain || false });
        }
    }
    process.exit(0);
}

main().catch(error => {
    tell("failed", { error: String(error) });
    process.exit(1);
});
