// Runs the commands that the page carries, or that a live server sends, on meshcat's viewer.
"use strict";

const THREE = MeshCat.THREE;
const tracks = [];

function notice(text) {
    const item = document.createElement("li");
    item.textContent = text;
    document.getElementById("notices").append(item);
}

function openViewer() {
    try {
        return new MeshCat.Viewer(document.getElementById("meshcat-pane"));
    } catch (error) {
        notice("This page needs WebGL, which this browser does not offer (" + error.message + ").");
        throw error;
    }
}

const viewer = openViewer();

function objectAt(path) {
    const names = path.split("/").filter((name) => name.length > 0);
    return viewer.scene_tree.find(names.concat("<object>")).object;
}

// -- commands beyond meshcat's own ------------------------------------------------------------

function setVertices(object, positions) {
    const geometry = object.geometry;
    const old = geometry.attributes.position;
    if (old && old.array.length === positions.length) {
        old.array.set(positions);
        old.needsUpdate = true;
    } else {
        const grown = new THREE.BufferGeometry();
        grown.setIndex(geometry.index);
        grown.setAttribute("position", new THREE.BufferAttribute(positions.slice(), 3));
        geometry.dispose();
        object.geometry = grown;
    }
    if (object.isMesh) {
        object.geometry.computeVertexNormals();
    }
}

function showTrack(track, time) {
    if (track.shown === time) {
        return;
    }
    track.shown = time;
    const size = track.positions.length / track.times.length;
    let after = track.times.findIndex((t) => t > time);
    if (after < 0) {
        after = track.times.length - 1;
    }
    const before = Math.max(after - 1, 0);
    const span = track.times[after] - track.times[before];
    let part = span > 0 ? Math.min(Math.max((time - track.times[before]) / span, 0), 1) : 0;
    if (!track.interpolate) {
        part = Math.round(part);
    }
    const from = track.positions.subarray(before * size, (before + 1) * size);
    const to = track.positions.subarray(after * size, (after + 1) * size);
    const mixed = from.map((value, i) => value + part * (to[i] - value));
    setVertices(objectAt(track.path), mixed);
}

const added = {
    set_vertices: (command) => setVertices(objectAt(command.path), command.positions),
    vertex_track: (command) => tracks.push(command),
    look_at: (command) => viewer.controls.target.fromArray(command.target),
    set_clock: (command) => { document.getElementById("clock").textContent = command.text; },
    notice: (command) => notice(command.text),
    set_joints: (command) => showJoints(command.values),
};

// -- the camera: free, following a body, or one of the scene's ----------------------------------

const camera = { path: null, last: null, fixed: null };

function poseOf(path) {
    const object = path === null ? viewer.scene_tree.find(["scene"]).object
        : viewer.scene_tree.find(path.split("/").filter((name) => name)).object;
    object.updateWorldMatrix(true, false);
    return object.matrixWorld;
}

function follow(path) {
    camera.path = path || null;
    camera.last = null;
}

function look(through) {
    if (camera.fixed === null && through) {
        camera.free = [viewer.camera.position.clone(), viewer.controls.target.clone(),
            viewer.camera.fov];
    } else if (camera.fixed !== null && !through) {
        viewer.camera.position.copy(camera.free[0]);
        viewer.controls.target.copy(camera.free[1]);
        viewer.camera.fov = camera.free[2];
        viewer.camera.up.set(0, 1, 0);
    }
    camera.fixed = through || null;
    viewer.controls.enabled = !through;
    viewer.set_dirty();
}

// What a page of 4 : 3 shows to the left and right is seen on narrower ones, too.
function fit() {
    viewer.camera.zoom = Math.min(1, 0.75 * window.innerWidth / window.innerHeight);
    viewer.set_dirty();
}

function placeCamera() {
    if (camera.fixed !== null) {
        const pose = poseOf(camera.fixed.path).clone()
            .multiply(new THREE.Matrix4().fromArray(camera.fixed.matrix));
        const x = new THREE.Vector3(), y = new THREE.Vector3(), z = new THREE.Vector3();
        pose.extractBasis(x, y, z);
        viewer.camera.position.setFromMatrixPosition(pose);
        viewer.controls.target.copy(viewer.camera.position).sub(z);
        viewer.camera.up.copy(y);
        viewer.camera.fov = camera.fixed.fov;
    } else if (camera.path !== null) {
        const now = new THREE.Vector3().setFromMatrixPosition(poseOf(camera.path));
        if (camera.last !== null) {
            const moved = now.clone().sub(camera.last);
            viewer.camera.position.add(moved);
            viewer.controls.target.add(moved);
        }
        camera.last = now;
    }
}

// -- what a live page can change ------------------------------------------------------------------

const joints = { values: {}, sliders: [], held: false };

function showJoints(values) {
    if (joints.held) {
        return;
    }
    joints.sliders.forEach((slider, i) => {
        joints.values[slider.property] = values[i];
        slider.updateDisplay();
    });
}

// dat.gui takes the number of digits that it shows from the first value: of a 0 none.
function fine(low, high) {
    return 10 ** Math.floor(Math.log10(Math.max(high - low, 1e-6) / 1000));
}

function offer(panel, send) {
    const ask = (what, more) => send(JSON.stringify({ do: what, ...more }));
    const gui = viewer.gui;
    const state = { speed: 1, backend: panel.backend, camera: "free", follow: "nothing",
        "by hand": false, ...panel.toggles };
    gui.add({ "pause / go on": () => send("pause") }, "pause / go on");
    gui.add({ "single step": () => send("step") }, "single step");
    gui.add({ "restart": () => send("restart") }, "restart");
    gui.add(state, "speed", 0.05, 5).step(0.05).onChange((value) => ask("speed", { value }));
    gui.add(state, "backend", panel.backends).onChange((name) => ask("backend", { name }));
    const named = Object.fromEntries(panel.cameras.map((one) => [one.name, one]));
    gui.add(state, "camera", ["free", ...Object.keys(named)]).onChange((name) => look(named[name]));
    gui.add(state, "follow", ["nothing", ...Object.keys(panel.bodies)])
        .onChange((name) => follow(panel.bodies[name]));
    Object.keys(panel.toggles).forEach((name) => {
        gui.add(state, name).onChange((on) => ask("show", { name, value: Number(on) }));
    });
    if (panel.joints.length > 0) {
        const folder = gui.addFolder("Joints");
        joints.sliders = panel.joints.map((joint, index) => {
            const name = `${index} ${joint.name}`;
            joints.values[name] = joint.value;
            return folder.add(joints.values, name, joint.low, joint.high)
                .step(fine(joint.low, joint.high))
                .onChange((value) => { joints.held = true; ask("joint", { index, value }); })
                .onFinishChange(() => { joints.held = false; });
        });
    }
    if (panel.actuators.length > 0) {
        const folder = gui.addFolder("Actuators");
        const hand = folder.add(state, "by hand")
            .onChange((on) => ask("manual", { value: Number(on) }));
        const values = {};
        panel.actuators.forEach((actuator, index) => {
            const name = `${index} ${actuator.name}`;
            values[name] = actuator.value;
            folder.add(values, name, actuator.low, actuator.high)
                .step(fine(actuator.low, actuator.high))
                .onChange((value) => {
                    state["by hand"] = true;
                    hand.updateDisplay();
                    ask("control", { index, value });
                });
        });
    }
}

// Objects with textures appear only when these are decoded; `drawn` waits for them.
let missing = 0;
let allDrawn = () => {};

function drawn() {
    return new Promise((done) => {
        allDrawn = done;
        if (missing === 0) {
            done();
        }
    });
}

const handleCommand = viewer.handle_command.bind(viewer);
viewer.handle_command = (command) => {
    missing += command.type === "set_object";
    (added[command.type] || handleCommand)(command);
    viewer.set_dirty();
};

// meshcat makes every object cast shadows, lights and floors too; here the object decides.
const setObject = viewer.set_object.bind(viewer);
viewer.set_object = (path, object) => {
    Object.assign(object, object.userData);
    setObject(path, object);
    if (object.target) {
        object.parent.add(object.target);  // lights shine at the origin of their node
    }
    missing -= 1;
    if (missing === 0) {
        allDrawn();
    }
};

const render = viewer.render.bind(viewer);
viewer.render = () => {
    tracks.forEach((track) => showTrack(track, viewer.animator.time));
    placeCamera();
    render();
};

// -- running them -----------------------------------------------------------------------------

function run(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    for (let at = 0; at < bytes.length;) {
        const end = at + 4 + view.getUint32(at, true);
        viewer.handle_command_bytearray(bytes.slice(at + 4, end));
        at = end;
    }
}

async function unpacked(text) {
    const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Before it was played once, meshcat's time slider moves nothing.
function pauseAt(time) {
    viewer.animator.play();
    viewer.animator.pause();
    viewer.animator.seek(time);
    viewer.animator.display_progress(time);
}

function openControls() {
    viewer.gui.width = 260;
    if (window.innerWidth < 600) {
        viewer.gui.close(); // it would hide the scene
    } else {
        viewer.gui.open();
    }
    viewer.gui.__folders["Scene"].close();
}

function followServer() {
    const secure = location.protocol === "https:";
    const socket = new WebSocket((secure ? "wss://" : "ws://") + location.host + "/stream");
    socket.binaryType = "arraybuffer";
    socket.onmessage = (message) => run(new Uint8Array(message.data));
    socket.onclose = () => notice("The simulation has ended.");
    offer(config.panel, (what) => socket.send(what));
    openControls();
}

async function start() {
    run(await unpacked(document.getElementById("commands").textContent));
    fit();
    window.addEventListener("resize", fit);
    if (viewer.animator.actions.length > 0) {
        openControls();
        const time = new URLSearchParams(location.hash.slice(1)).get("t");
        if (time !== null) {
            pauseAt(Number(time));
        }
    }
    await drawn();
    if (config.live) {
        followServer();
    }
}

window.orbisim = { viewer, THREE, ready: start() };
