"""MAVLink over TCP and serial: streams that end are taken up again, without a busy loop."""

import asyncio
import os
import time
import tty

import numpy as np
from benches import FRAME, around, until

from drivers.emulators.rover import RoverAutopilot
from drivers.mavlink.fleet import open_link
from fieldkit.clock import ScaledClock
from fieldkit.testing import nothing_left
from fieldkit.world.bodies import Car


def autopilot():
    return RoverAutopilot(1, Car(0.0, 0.0), FRAME, np.random.default_rng(1))


class TcpVehicle:
    """A simulator's TCP port: one client, the rover behind it."""

    def __init__(self, clock):
        self.clock, self.rover, self.writer, self.clients, self.port = clock, autopilot(), None, 0, 0

    async def open(self):
        self.server = await asyncio.start_server(self.serve, "127.0.0.1", self.port)
        self.port = self.server.sockets[0].getsockname()[1]

    async def serve(self, reader, writer):
        self.clients += 1
        self.writer = writer
        feeding = asyncio.create_task(self.feed(writer))
        try:
            while data := await reader.read(4096):
                writer.write(self.rover.receive(data, self.clock.elapsed_s()))
        except ConnectionError:
            pass
        finally:
            feeding.cancel()
            writer.close()

    async def feed(self, writer):
        while True:
            writer.write(self.rover.update(self.clock.elapsed_s()))
            await self.clock.sleep(0.1)

    def hang_up(self):
        self.server.close()
        self.writer.transport.abort()


async def test_a_tcp_link_that_ends_is_taken_up_again():
    clock = ScaledClock(10.0)
    vehicle = TcpVehicle(clock)
    await vehicle.open()
    async with (
        nothing_left(),
        open_link(f"tcp:127.0.0.1:{vehicle.port}", {"ada": {"system_id": 1}}, around(clock)) as link,
    ):
        await link.acquire_control("ada")
        vehicle.hang_up()
        busy_s = time.process_time()
        await asyncio.sleep(0.5)
        assert time.process_time() - busy_s < 0.3, "busy while there is nothing to read"
        await vehicle.open()
        await until(lambda: vehicle.clients == 2)
        await link.hold("ada")
        vehicle.server.close()
        vehicle.writer.close()
    await asyncio.sleep(0.05)


async def test_a_serial_link_steers():
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    clock, rover = ScaledClock(3.0), autopilot()
    loop = asyncio.get_running_loop()

    def answer():
        os.write(master, rover.receive(os.read(master, 4096), clock.elapsed_s()))

    async def live():
        while True:
            os.write(master, rover.update(clock.elapsed_s()))
            await clock.sleep(0.1)

    loop.add_reader(master, answer)
    task = asyncio.create_task(live())
    address = f"serial:{os.ttyname(slave)}:57600"
    async with nothing_left(), open_link(address, {"ada": {"system_id": 1}}, around(clock)) as link:
        await link.acquire_control("ada")
        assert rover.armed
        await link.hold("ada")
    loop.remove_reader(master)
    task.cancel()
    await asyncio.wait({task})
    os.close(master)
    os.close(slave)
