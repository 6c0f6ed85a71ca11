// A report's page is given the one for the other: both export the same.
import * as recorded from "../../mission/page/static/recorded.js";
import * as socket from "../../mission/page/static/socket.js";

export const twin: typeof socket = recorded;
